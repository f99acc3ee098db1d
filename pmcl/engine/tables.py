"""What all coefficient tables have in common: declared axes, and further fields that only the full kernels read.

A table is a NamedTuple of arrays and numbers. Each of its fields declares its axes in its annotation::

    from typing import Annotated, NamedTuple

    from numpy.typing import NDArray
    from pmcl.engine import Axes, NoExtras

    class MyExtras(NamedTuple):
        growth: Annotated[NDArray, Axes("beam", neutral=0.0)]

    class MyTable(NamedTuple):
        std: Annotated[NDArray, Axes("beam")]
        extras: NoExtras | MyExtras = NoExtras()

Fields that only effects use stand in the table's ``extras``, whose annotation names their types. Kernels are compiled
for the type of the extras: with :class:`NoExtras` the fast ones, with the table's own type the full ones, some three
times slower. An effect does not choose: it names the fields that it changes, and :func:`with_fields` adds extras where
one of them needs it. Each field of the extras declares the neutral value at which the full kernels have the density of
the fast ones.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Axes",
    "FieldView",
    "NoExtras",
    "axes_of",
    "axis_sizes",
    "channels_that_differ",
    "extras_types",
    "field_of",
    "same_extras",
    "some_channels",
    "with_extras",
    "with_fields",
]


class NoExtras(NamedTuple):
    """The extras of a table that has only its plain fields: fast kernels serve it."""


class Axes:
    """Declares the axes of a table's field.

    Parameters
    ----------
    *names : str or int
        Name of each axis, such as ``"time"`` or ``"beam"``; an int is a fixed size. None of them for a number.
    neutral : float or callable, optional
        For a field of extras: the value without effect, or a function that makes it of the table.
    """

    def __init__(self, *names: str | int, neutral: float | Callable[[Any], Any] | None = None) -> None:
        self.names, self.neutral = names, neutral


@functools.cache
def _declared(table_type: type) -> dict[str, Axes]:
    found = {}
    for name, hint in get_type_hints(table_type, include_extras=True).items():
        for note in getattr(hint, "__metadata__", ()):
            if isinstance(note, Axes):
                found[name] = note
    return found


@functools.cache
def _extras_types(table_type: Any) -> tuple[Any, ...]:
    if "extras" not in table_type._fields:
        return ()
    return tuple(kind for kind in get_args(get_type_hints(table_type)["extras"]) if kind is not NoExtras)


def extras_types(table: Any) -> tuple[Any, ...]:
    """Return the types of extras that a table may have, as its annotation lists them; each extends those before it."""
    table_type: Any = type(table)
    return _extras_types(table_type)


def axes_of(table_type: type) -> dict[str, tuple[str | int, ...]]:
    """Return the axes of each field of a table type that declares them.

    Parameters
    ----------
    table_type : type
        A NamedTuple type of a table or of its extras.

    Returns
    -------
    dict of str to tuple
    """
    return {name: axes.names for name, axes in _declared(table_type).items()}


def axis_sizes(table: Any) -> dict[str, int]:
    """Return the size of each named axis, as the table's own fields have it; of the extras, nothing is read."""
    table_type: Any = type(table)
    return {axis: np.shape(getattr(table, name))[place] for axis, name, place in _where_axes_are(table_type)}


@functools.cache
def _where_axes_are(table_type: type) -> tuple[tuple[str, str, int], ...]:
    """Return each named axis with the first field that has it, and its place there."""
    found: dict[str, tuple[str, int]] = {}
    for name, axes in _declared(table_type).items():
        for place, axis in enumerate(axes.names):
            if isinstance(axis, str):
                found.setdefault(axis, (name, place))
    return tuple((axis, name, place) for axis, (name, place) in found.items())


def _neutral(axes: Axes, table: Any, sizes: Mapping[str, int]) -> Any:
    if callable(axes.neutral):
        return axes.neutral(table)
    assert axes.neutral is not None, "each field of extras declares a neutral value"
    if not axes.names:
        return float(axes.neutral)
    return np.full([axis if isinstance(axis, int) else sizes.get(axis, 0) for axis in axes.names], float(axes.neutral))


@functools.lru_cache(maxsize=256)
def _neutral_constants(target: type, sizes: tuple[tuple[str, int], ...]) -> dict[str, Any]:
    """Return the neutral values that do not depend on a table; no array of a table is ever written to."""
    own = _declared(target)
    return {name: _neutral(axes, None, dict(sizes)) for name, axes in own.items() if not callable(axes.neutral)}


def with_extras(table: Any, extras_type: type | None = None) -> Any:
    """Return a table with extras, neutral where it had none; densities stay the same.

    Parameters
    ----------
    table : NamedTuple
        A table. One that has the extras already, or whose type declares none, comes back as it is.
    extras_type : type, optional
        Which of the declared types (:func:`extras_types`); the first when left out.

    Returns
    -------
    NamedTuple
    """
    known = extras_types(table)
    if not known:
        return table
    target = known[0] if extras_type is None else extras_type
    present = type(table.extras)
    if present is target or (present in known and known.index(present) > known.index(target)):
        return table
    # Tables are made anew for each proposal of a sampler, most of them of the same sizes.
    constants = _neutral_constants(target, tuple(axis_sizes(table).items()))
    values = {
        name: constants[name] if name in constants else _neutral(axes, table, {})
        for name, axes in _declared(target).items()
    }
    return table._replace(extras=target(**{**values, **table.extras._asdict()}))


def with_fields(table: Any, changes: Mapping[str, Any]) -> Any:
    """Return a table with some fields replaced; extras are added when one of the fields is theirs.

    Parameters
    ----------
    table : NamedTuple
        A table.
    changes : mapping of str to value
        New values by the name of the field, whether it is the table's own or of its extras.

    Returns
    -------
    NamedTuple

    Raises
    ------
    ValueError
        When neither the table nor its extras have such a field.
    """
    own = {name: value for name, value in changes.items() if name in table._fields}
    others = {name: value for name, value in changes.items() if name not in own}
    if others:
        for kind in extras_types(table):
            if set(others) <= set(kind._fields):
                table = with_extras(table, kind)
                break
        else:
            raise ValueError(f"a {type(table).__name__} has no field {sorted(others)[0]!r}")
        own["extras"] = table.extras._replace(**others)
    return table._replace(**own)


def field_of(table: Any, name: str) -> Any:
    """Return a field of a table or of its extras; a field of extras that it does not have is neutral.

    Raises
    ------
    AttributeError
        When neither the table nor any of its types of extras has such a field.
    """
    if name in table._fields:
        return getattr(table, name)
    extras = getattr(table, "extras", None)
    if extras is not None and name in extras._fields:
        return getattr(extras, name)
    for kind in extras_types(table):
        if name in kind._fields:
            return _neutral(_declared(kind)[name], table, axis_sizes(table))
    raise AttributeError(f"a {type(table).__name__} has no field {name!r}")


def same_extras(table: Any, other: Any) -> tuple[Any, Any]:
    """Return two tables of one type with extras of one type: of the one that has more, or none."""
    kinds = (NoExtras, *extras_types(table))
    ranks = [kinds.index(type(each.extras)) if "extras" in each._fields else 0 for each in (table, other)]
    if ranks[0] == ranks[1]:
        return table, other
    target = kinds[max(ranks)]
    return with_extras(table, target), with_extras(other, target)


def channels_that_differ(table: Any, other: Any, axis: str, ignore: Iterable[str] = ()) -> NDArray[np.bool_] | None:
    """Return in which places of one axis two tables of one type, with extras of one type, differ.

    Parameters
    ----------
    table, other : NamedTuple
        The tables.
    axis : str
        Name of the axis, e.g. ``"beam"``.
    ignore : iterable of str
        Fields that are not looked at.

    Returns
    -------
    ndarray of bool, or None
        None where the tables differ in a field that does not have the axis.
    """
    differ = np.zeros(axis_sizes(table)[axis], dtype=bool)
    pairs = [(table, other)]
    if "extras" in table._fields:
        pairs.append((table.extras, other.extras))
    for first, second in pairs:
        axes = axes_of(type(first))
        for name in first._fields:
            a, b = getattr(first, name), getattr(second, name)
            if a is b or name in ignore or name == "extras":
                continue
            if axis in axes.get(name, ()):
                place = axes[name].index(axis)
                others = tuple(k for k in range(np.ndim(a)) if k != place)
                differ |= ((a != b) & ~(np.isnan(a) & np.isnan(b))).any(axis=others)
            elif not np.array_equal(a, b):
                return None
    return differ


def some_channels(table: Any, axis: str, kept: NDArray[np.int64]) -> Any:
    """Return a table with some places of one axis only, in all of its fields and those of its extras."""
    changes = {
        name: np.ascontiguousarray(np.take(getattr(table, name), kept, axis=axes.index(axis)))
        for name, axes in axes_of(type(table)).items()
        if axis in axes
    }
    if "extras" in table._fields:
        changes["extras"] = some_channels(table.extras, axis, kept)
    return table._replace(**changes)


class FieldView:
    """Reads the fields of a table and of its extras alike; fields of extras that it does not have are neutral.

    Parameters
    ----------
    table : NamedTuple
        A table.
    """

    def __init__(self, table: Any) -> None:
        self._table = table

    def __getattr__(self, name: str) -> Any:
        return field_of(self._table, name)
