"""Priors in model files: the name of a scipy.stats distribution and its arguments."""

from __future__ import annotations

import math
from typing import Any, NoReturn

import numpy as np
from scipy import stats

from pmcl.errors import ModelError, did_you_mean
from pmcl.models.parameters import Parameter, prior_support

__all__ = ["checked_number", "prior_from_table", "prior_to_table"]

# The greatest number in a model file, without its sign. No parameter in SI units, no shape of a distribution and no
# place comes near it; far beyond it, densities are no numbers any more.
_GREATEST = 1.0e9

# Between these quantiles lies half of a prior.
_QUARTILES = (0.25, 0.75)


def checked_number(where: str, key: str, value: Any) -> float:
    """Return a number of a model file as a float; raises ModelError for anything else, and beyond the greatest one.

    Parameters
    ----------
    where, key : str
        File and key, for messages.
    value : object
        What stands there.
    """
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number and abs(value) <= _GREATEST:
        return float(value)
    # Whole numbers may be too large for a float.
    expected = f"number within {_GREATEST:g}" if is_number and abs(value) < math.inf else "finite number"
    _fail(where, key, f"expected a {expected}, but got {value!r:.60}; correct it")


def prior_from_table(where: str, parameter: Parameter, table: Any) -> Any:
    """Turn ``{"distribution": "gamma", "a": 2.0, "scale": 0.05}`` into a frozen distribution.

    Parameters
    ----------
    where : str
        File, for messages.
    parameter : Parameter
        The prior belongs to it; its role decides which values are possible.
    table : dict
        ``distribution``, the shape arguments under their scipy names, and optionally ``loc`` and ``scale``.

    Returns
    -------
    scipy.stats frozen distribution

    Raises
    ------
    ModelError
        When there is no such distribution, an argument is unknown, missing or not allowed, or the support is not one
        that the parameter can have.
    """
    key = f"priors.{parameter.name}"
    if not isinstance(table, dict) or "distribution" not in table:
        _fail(where, key, f"expected a table with the key 'distribution', but got {table!r}; write for example "
              '{ distribution = "gamma", a = 2.0, scale = 0.05 }')  # fmt: skip
    family = _family(where, f"{key}.distribution", table["distribution"])
    shapes = [shape.strip() for shape in family.shapes.split(",")] if family.shapes else []
    arguments = {argument: value for argument, value in table.items() if argument != "distribution"}
    known = [*shapes, "loc", "scale"]
    for argument, value in arguments.items():
        if argument not in known:
            advice = did_you_mean(argument, known, "remove it")
            _fail(
                where,
                f"{key}.{argument}",
                f"expected one of {', '.join(known)} for {family.name}, but got '{argument}'; {advice}",
            )
        checked_number(where, f"{key}.{argument}", value)
    missing = [shape for shape in shapes if shape not in arguments]
    if missing:
        _fail(
            where, key, f"expected the shape '{missing[0]}' of {family.name}, but got none; add {missing[0]} = NUMBER"
        )
    # Shapes by position and the rest by name, as priors are usually written in Python.
    positional = [arguments.pop(shape) for shape in shapes]
    return _checked(where, key, parameter, family(*positional, **arguments))


def prior_to_table(name: str, prior: Any) -> dict[str, str | int | float]:
    """Undo :func:`prior_from_table`.

    Parameters
    ----------
    name : str
        The parameter, for messages.
    prior : scipy.stats frozen distribution
        Its prior.

    Returns
    -------
    dict of str to str or number
        ``distribution`` and the arguments by their scipy names.

    Raises
    ------
    ModelError
        For a prior that is no frozen continuous distribution of scipy.stats, which a file cannot name.
    """
    family = getattr(prior, "dist", None)
    if not isinstance(family, stats.rv_continuous) or _by_name(family.name) is None:
        raise ModelError(
            f"expected a prior of {name} that is a named distribution of scipy.stats, but got {type(prior).__name__}; "
            "a model file can hold no other: build the model in Python"
        )
    shapes = [shape.strip() for shape in family.shapes.split(",")] if family.shapes else []
    given = {**dict(zip([*shapes, "loc", "scale"], prior.args, strict=False)), **prior.kwds}
    return {"distribution": family.name} | {key: _plain(value) for key, value in given.items()}


def _by_name(name: str) -> stats.rv_continuous | None:
    found = getattr(stats, name, None)
    return found if isinstance(found, stats.rv_continuous) else None


def _family(where: str, key: str, name: Any) -> stats.rv_continuous:
    found = _by_name(name) if isinstance(name, str) else None
    if found is None:
        names = [each for each in dir(stats) if _by_name(each) is not None]
        advice = did_you_mean(str(name), names, "gamma, lognorm, norm, uniform and beta are usual")
        _fail(where, key, f"expected the name of a continuous distribution of scipy.stats, but got {name!r}; {advice}")
    return found


def _checked(where: str, key: str, parameter: Parameter, prior: Any) -> Any:
    low, high = prior_support(prior)
    problem = ""
    with np.errstate(all="ignore"):
        quartiles = prior.ppf(_QUARTILES) if low < high else np.zeros(2)
        density = prior.logpdf(0.5 * quartiles.sum()) if low < high else math.nan
    if not low < high:
        problem = f"expected arguments that {prior.dist.name} allows, but got {_in_words(prior)}; correct them"
    elif parameter.scales_noise and low < 0.0:
        problem = f"expected numbers >= 0, but {_in_words(prior)} reaches down to {low:g}; choose gamma or lognorm"
    elif parameter.role == "weight" and (low < 0.0 or high > 1.0):
        problem = f"expected numbers in [0, 1], but {_in_words(prior)} spans {low:g} to {high:g}; choose beta"
    elif not (low < quartiles[0] < quartiles[1] < high and abs(quartiles).max() < _GREATEST and np.isfinite(density)):
        problem = (
            f"expected a prior that spreads over numbers within {_GREATEST:g}, but the quartiles of {_in_words(prior)} "
            f"are {quartiles[0]:g} and {quartiles[1]:g}; choose other arguments"
        )
    if problem:
        _fail(where, key, problem)
    return prior


def _in_words(prior: Any) -> str:
    arguments = [f"{value:g}" for value in prior.args] + [f"{key}={value:g}" for key, value in prior.kwds.items()]
    return f"{prior.dist.name}({', '.join(arguments)})"


def _plain(value: Any) -> int | float:
    plain = value.item() if isinstance(value, np.generic | np.ndarray) else value
    return int(plain) if isinstance(plain, int) else float(plain)


def _fail(where: str, key: str, message: str) -> NoReturn:
    raise ModelError(f"{where}, key '{key}': {message}")
