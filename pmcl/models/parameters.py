"""Parameters with names, units and priors, and the arrays of priors that compiled code reads."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.checks import check_choice, check_type
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.errors import ModelError

__all__ = [
    "ROLES", "Parameter", "PriorTable", "gamma_prior", "log_prior_function", "prior_rows", "prior_support",
    "prior_table",
]  # fmt: skip

Float = NDArray[np.float64]


class _Family(NamedTuple):
    """A family of priors whose log density needs no scipy, with y = (x - loc) / scale and shapes a and b.

    The log density is ``constant(a, b) - log(scale) + of_y(y, a, b)``.

    Attributes
    ----------
    support : tuple of float
        Between which numbers y lies.
    constant, of_y : callable
        Its two terms.
    """

    support: tuple[float, float]
    constant: Callable[[float, float], float]
    of_y: Callable[[float, float, float], float]


_ABOVE_0, _ANY, _0_TO_1 = (0.0, math.inf), (-math.inf, math.inf), (0.0, 1.0)

# By scipy name. Shapes that a family does not allow give NaN, as in scipy.
_FAMILIES: dict[str, _Family] = {
    "norm": _Family(_ANY, lambda a, b: -HALF_LOG_2PI, lambda y, a, b: -0.5 * y * y),
    "gamma": _Family(
        _ABOVE_0, lambda a, b: -math.lgamma(a) if a > 0 else math.nan, lambda y, a, b: (a - 1.0) * math.log(y) - y
    ),
    "lognorm": _Family(
        _ABOVE_0,
        lambda a, b: -HALF_LOG_2PI - math.log(a) if a > 0 else math.nan,
        lambda y, a, b: -math.log(y) - 0.5 * (math.log(y) / a) ** 2,
    ),
    "uniform": _Family(_0_TO_1, lambda a, b: 0.0, lambda y, a, b: 0.0),
    "beta": _Family(
        _0_TO_1,
        lambda a, b: math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) if min(a, b) > 0 else math.nan,
        lambda y, a, b: (a - 1.0) * math.log(y) + (b - 1.0) * math.log1p(-y),
    ),
    "halfnorm": _Family(_ABOVE_0, lambda a, b: 0.5 * math.log(2.0 / math.pi), lambda y, a, b: -0.5 * y * y),
    "expon": _Family(_ABOVE_0, lambda a, b: 0.0, lambda y, a, b: -y),
    "invgamma": _Family(
        _ABOVE_0,
        lambda a, b: -math.lgamma(a) if a > 0 else math.nan,
        lambda y, a, b: -(a + 1.0) * math.log(y) - 1.0 / y,
    ),
}

FAMILIES = {name: code for code, name in enumerate(_FAMILIES)}
"""Number of each family in :attr:`PriorTable.family`; ``log_prior`` of the Metropolis kernels knows it."""


ROLES: dict[str, str] = {
    "noise": "a standard deviation, or a ratio that acts as one: above 0, since a density needs some noise",
    "noise growth": "by how much a standard deviation grows with motion or distance: at least 0",
    "weight": "the probability of a component of a mixture: 0 to 1",
    "other": "anything else",
}
"""What a parameter is in its model, with the values that it may have."""


@dataclass(frozen=True)
class Parameter:
    """One unknown of a model.

    Attributes
    ----------
    name : str
        As in files and tables, e.g. ``sigma_forward``.
    unit : str
        SI unit, "1" for a pure number.
    prior : scipy.stats frozen distribution
        Any continuous one.
    description : str
        One sentence for people.
    role : str
        What it is in its model, one of :data:`ROLES`. Checks of values and of priors follow from it.

    Raises
    ------
    ModelError
        When the prior is no distribution, or the role is unknown.
    """

    name: str
    unit: str
    prior: Any
    description: str = ""
    role: str = "other"

    def __post_init__(self) -> None:
        """Check that the prior can be drawn from and evaluated."""
        for what in ("name", "unit", "description"):
            check_type(f"{what} of a parameter", getattr(self, what), str, error=ModelError, advice="write a text")
        if not self.name:
            raise ModelError("expected a name of a parameter, but got an empty text; call it for example 'sigma_range'")
        check_choice(f"the role of {self.name}", self.role, ROLES, error=ModelError)
        if not (hasattr(self.prior, "logpdf") and hasattr(self.prior, "rvs") and hasattr(self.prior, "support")):
            raise ModelError(
                f"the prior of {self.name} must be a frozen continuous scipy.stats distribution, "
                f"but got {type(self.prior).__name__}; write for example scipy.stats.gamma(2, scale=0.05)"
            )

    @property
    def scales_noise(self) -> bool:
        """Whether its value is an amount of noise, constant or growing."""
        return self.role in ("noise", "noise growth")


class PriorTable(NamedTuple):
    """Priors as numbers: family code, two shapes, location, scale and the constant of the log density; (d,) each."""

    family: NDArray[np.int64]
    shape_a: Float
    shape_b: Float
    loc: Float
    scale: Float
    constant: Float


@functools.lru_cache(maxsize=256)  # scipy takes a millisecond to make one, and parts ask for theirs again and again
def gamma_prior(mean: float, shape: float = 2.0) -> Any:
    """Return the gamma distribution with a given mean.

    Parameters
    ----------
    mean : float
        Mean, in the parameter's unit.
    shape : float
        Shape; at 2 the density is zero at zero and has a long tail.

    Returns
    -------
    scipy.stats frozen distribution
    """
    return stats.gamma(shape, scale=mean / shape)


def prior_support(prior: Any) -> tuple[float, float]:
    """Return the lowest and highest value that a prior allows."""
    low, high = prior.support()
    return float(low), float(high)


def _numbers(prior: Any) -> tuple[int, float, float, float, float, float] | None:
    """Return (family, a, b, loc, scale, constant), or None for a family that compiled code does not know."""
    name = getattr(getattr(prior, "dist", None), "name", "")
    if name not in FAMILIES:
        return None
    shapes, loc, scale = prior.dist._parse_args(*prior.args, **prior.kwds)
    a = float(shapes[0]) if len(shapes) > 0 else 0.0
    b = float(shapes[1]) if len(shapes) > 1 else 0.0
    constant = _FAMILIES[name].constant(a, b)
    return FAMILIES[name], a, b, float(loc), float(scale), constant - math.log(scale)


def prior_table(parameters: Sequence[Parameter]) -> PriorTable | None:
    """Return all priors as one table, or None when one of them is of a family that compiled code does not know."""
    rows = [_numbers(parameter.prior) for parameter in parameters]
    known = [row for row in rows if row is not None]
    if len(known) < len(rows):
        return None
    columns = np.array(known, dtype=float).reshape(-1, 6).T
    return PriorTable(columns[0].astype(np.int64), *(np.ascontiguousarray(column) for column in columns[1:]))


def prior_rows(table: PriorTable, rows: NDArray[np.int64]) -> PriorTable:
    """Return the priors of some parameters.

    Parameters
    ----------
    table : PriorTable
        Priors of d parameters.
    rows : ndarray of int, shape (k,)
        Positions of some of them.

    Returns
    -------
    PriorTable
        Of these k.
    """
    shape_a, shape_b, loc, scale, constant = (column[rows] for column in table[1:])
    return PriorTable(table.family[rows], shape_a, shape_b, loc, scale, constant)


def log_prior_function(parameters: Sequence[Parameter]) -> Callable[[Float], float]:
    """Return a function theta -> log prior density; -inf outside the support.

    Known families are evaluated by their formula (a call of scipy costs 50 microseconds, one of these less than one).
    """
    terms = [_log_density(parameter.prior) for parameter in parameters]

    def log_prior(theta: Float) -> float:
        value = 0.0
        for term, x in zip(terms, theta.tolist(), strict=True):
            value += term(x)
            if value == -math.inf:
                break
        return value

    return log_prior


def _log_density(prior: Any) -> Callable[[float], float]:
    numbers = _numbers(prior)
    if numbers is None:

        def from_scipy(x: float) -> float:
            value = float(prior.logpdf(x))
            return -math.inf if math.isnan(value) else value

        return from_scipy
    code, a, b, loc, scale, constant = numbers
    # Looked up once: this is called for each parameter at every proposal.
    (low, high), _, of_y = list(_FAMILIES.values())[code]

    def known(x: float) -> float:
        y = (x - loc) / scale
        return constant + of_y(y, a, b) if low < y < high else -math.inf

    return known
