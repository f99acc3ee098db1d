"""Compilation: one decorator for all kernels, a disk cache that cannot go stale, dispatch on the type of a table.

Three things numba does not do by itself:

* :func:`kernel` compiles without the global interpreter lock, with division semantics of NumPy and only those
  floating-point liberties that keep NaN and infinity meaningful.
* :func:`entry` and :func:`kernel` keep what they compiled on disk. numba looks only at the file of the function itself;
  :mod:`~pmcl.engine.disk_cache` also at every kernel source and every file that registers an
  implementation, so that a stale kernel can never run.
* :func:`generic` makes a function of which each table type has its own implementation, chosen at compile time.
  The result is one specialised loop per model, without function pointers. Called from Python it
  runs the same implementation uncompiled, which is what the tests compare with.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from numba import types
from numba.core.typing.templates import infer, infer_global

from pmcl.engine.disk_cache import remember_source
from pmcl.engine.functions import EntryFunction, InnerFunction, call_template

__all__ = ["entry", "generic", "kernel", "overload_for_types"]

# Type of a table, and of its extras where the implementation is for those alone.
_Key = tuple[type, type | None]
# Types of tables that have registered some implementation. The defaults, which serve all types, serve no other: a table
# whose own implementations are not imported yet would get them by mistake, and the cache would keep what was compiled.
_types_with_implementations: set[type] = set()

_CONTRACT = {"contract", "nsz"}


def _options(*, reorder: bool = False, strict: bool = False, allocates: bool = False) -> Any:
    flags = set() if strict else set(_CONTRACT)
    if reorder:
        flags |= {"reassoc"}
    # Nothing here is called from C: that wrapper alone would be a tenth of the compilation time.
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": flags, "no_cfunc_wrapper": True}
    if not allocates:
        # Without reference counting: each atomic count of an array view costs as much as ten particles.
        options["_nrt"] = False
    return options


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    reorder: bool = False,
    strict: bool = False,
) -> Any:
    """Compile a function that is called from other kernels and allocates nothing.

    Parameters
    ----------
    function : callable
        The function; may be left out when options are given.
    reorder : bool
        Sums may be reordered (needed to vectorise a reduction).
    strict : bool
        Every operation is rounded as written: products and sums are not fused.
    """
    if function is None:
        return functools.partial(kernel, reorder=reorder, strict=strict)
    remember_source(function)
    return InnerFunction(function, _options(reorder=reorder, strict=strict))


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, and keep its machine code on disk."""
    remember_source(function)
    return EntryFunction(function, _options(allocates=True))


def generic(prototype: Callable[..., Any]) -> Any:
    """Make a function that each table type implements for itself.

    Parameters
    ----------
    prototype : callable
        Its signature and docstring are the contract; its body is never run.

    Returns
    -------
    callable
        With the attribute ``register(TableType, *extras types, allocates=False)``, a decorator for implementations:
        plain functions that numba can compile; one that makes arrays says ``allocates=True`` and runs slower (without
        it, its first compilation raises :class:`~pmcl.errors.ModelError`). With
        types of extras (:mod:`pmcl.engine.tables`) it serves only tables that have such extras.
        An implementation for ``object`` serves all types that have none of their own.
        From Python the call goes to the implementation uncompiled.
    """
    implementations: dict[_Key, Callable[..., Any]] = {}

    @functools.wraps(prototype)
    def dispatch(*arguments: Any) -> Any:
        table = arguments[0]
        implementation = _for_types(implementations, type(table), type(getattr(table, "extras", None)))
        if implementation is None:
            known = ", ".join(sorted({kind.__name__ for kind, _ in implementations}))
            raise TypeError(
                f"{prototype.__name__} has no implementation for a table of type "
                f"{type(table).__name__} (it has: {known}); register one"
            )
        return implementation(*arguments)

    compiled: dict[_Key, InnerFunction] = {}

    def choose(table: Any, *others: Any) -> InnerFunction | None:
        if isinstance(table, types.NamedTuple | types.NamedUniTuple):
            return _for_types(compiled, table.instance_class, _extras_class(table))
        return None

    _let_numba_choose(dispatch, choose)

    def register(
        table_type: type, *extras_types: type, allocates: bool = False
    ) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def decorate(implementation: Callable[..., Any]) -> Callable[..., Any]:
            function = InnerFunction(implementation, _options(allocates=allocates))
            _types_with_implementations.add(table_type)
            for extras_type in extras_types or (None,):
                remember_source(implementation, extras_type or table_type)
                implementations[table_type, extras_type] = implementation
                compiled[table_type, extras_type] = function
            return implementation

        return decorate

    dispatch.register = register  # type: ignore[attr-defined]
    dispatch.implementations = implementations  # type: ignore[attr-defined]
    dispatch.compiled = compiled  # type: ignore[attr-defined]
    return dispatch


def _for_types(registered: dict[_Key, Any], table_type: type, extras_type: type | None) -> Any:
    """Return what is registered for a table with such extras, for the table whatever its extras, or for all tables."""
    for key in ((table_type, extras_type), (table_type, None)):
        if key in registered:
            return registered[key]
    return registered.get((object, None)) if table_type in _types_with_implementations else None


def _extras_class(table: Any) -> type | None:
    """Return the class of the extras of a table, given the numba type of the table."""
    if "extras" not in table.fields:
        return None
    extras = table.types[table.fields.index("extras")]
    return getattr(extras, "instance_class", None)


def overload_for_types(function: Callable[..., Any]) -> Any:
    """Decorate a typing function that chooses an allocation-free implementation of `function` by argument types."""

    def decorate(choose_source: Callable[..., Callable[..., Any] | None]) -> Callable[..., Any]:
        compiled: dict[Any, InnerFunction] = {}

        def choose(*kinds: Any) -> InnerFunction | None:
            source = choose_source(*kinds)
            if source is None:
                return None
            return compiled.setdefault(source.__code__, InnerFunction(source, _options()))

        _let_numba_choose(function, choose)
        return choose_source

    return decorate


def _let_numba_choose(function: Callable[..., Any], choose: Callable[..., InnerFunction | None]) -> None:
    template = call_template(function, choose)
    infer(template)
    infer_global(function, types.Function(template))
