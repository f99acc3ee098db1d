"""How well a log tells a parameter: its spread, and whether the posterior is still the prior."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["TELLS_NOTHING", "Spread", "overlap", "spread_of"]

Float = NDArray[np.float64]

TELLS_NOTHING = 0.83
"""Overlap [1] of posterior and prior from which on a log is said not to tell a parameter.

Two normals of one mean whose standard deviations have the ratio 1/sqrt(2) overlap by 0.834. That is what one direct
reading of the parameter leaves, when it is as uncertain as the prior itself. A log above this bound tells less.
"""

# Parts of equal prior probability in which draws are counted. With 400 effective draws an unchanged prior then
# overlaps by 0.94 on average (expected absolute deviation of ten binomial shares); with 20 parts it would be 0.91.
_PARTS = 10


class Spread(NamedTuple):
    """Spread of a quantity under the posterior.

    Attributes
    ----------
    mean, sd : float
        Mean and standard deviation, in the quantity's unit.
    low, high : float
        Ends of the central 90 % interval.
    overlap : float
        Overlap with the prior, 0 to 1; NaN when the prior is unknown.
    """

    mean: float
    sd: float
    low: float
    high: float
    overlap: float

    @property
    def told(self) -> bool:
        """Whether the log says more about it than the prior."""
        return not self.overlap >= TELLS_NOTHING


def overlap(prior: Float, posterior: Float) -> float:
    """Return the probability that two distributions share, the integral of the lesser density.

    Parameters
    ----------
    prior : ndarray, shape (P,)
        Draws of the prior.
    posterior : ndarray, shape (S,)
        Draws of the posterior.

    Returns
    -------
    float
        From 0 (apart) to 1 (the same), counted in ten parts of equal prior probability. It does not depend on the
        parameter's scale: a logarithm has the same overlap. Shifted and narrowed posteriors both reduce it.
    """
    edges = np.quantile(prior, np.linspace(0.0, 1.0, _PARTS + 1)[1:-1])
    shares = np.bincount(np.searchsorted(edges, posterior), minlength=_PARTS) / posterior.size
    expected = np.bincount(np.searchsorted(edges, prior), minlength=_PARTS) / prior.size
    return float(np.minimum(shares, expected).sum())


def spread_of(posterior: Float, prior: Float | None = None) -> Spread:
    """Return the spread of a quantity.

    Parameters
    ----------
    posterior : ndarray, shape (S,)
        Draws of the posterior.
    prior : ndarray, shape (P,), optional
        Draws of the prior.

    Returns
    -------
    Spread
    """
    low, high = np.quantile(posterior, [0.05, 0.95])
    shared = float("nan") if prior is None or prior.size == 0 or posterior.size < 2 else overlap(prior, posterior)
    return Spread(float(posterior.mean()), float(posterior.std()), float(low), float(high), shared)
