"""Learning curves: convergence and error of the first draws of a run, for growing numbers of draws."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.posterior.compat import bulk_ess, mcse_of_mean, r_hat

__all__ = ["Curve", "Reference", "learning_curve", "reference_of", "worst_ess", "worst_r_hat"]

Float = NDArray[np.float64]

# R-hat and ESS split every chain in two and need a few draws of each half.
_LEAST_DRAWS = 8
_POINTS = 24


class Reference(NamedTuple):
    """The posterior that the others are held against.

    Attributes
    ----------
    mean, sd : ndarray, shape (d,)
        Of each parameter, in its unit.
    error : float
        Monte Carlo standard error of `mean` in units of `sd`, root mean square over the parameters.
    r_hat, ess : float
        Of the parameter where they are worst.
    """

    mean: Float
    sd: Float
    error: float
    r_hat: float
    ess: float


class Curve(NamedTuple):
    """A run at growing numbers of draws.

    Attributes
    ----------
    draws : ndarray of int, shape (P,)
        Draws of each chain, after burn-in.
    wall, cpu : ndarray, shape (P,)
        Seconds from the start of the run, burn-in included: by the clock, and of all cores together.
    r_hat, ess : ndarray, shape (P,)
        R-hat and bulk effective sample size of the parameter where they are worst.
    error : ndarray, shape (P,)
        Distance of the mean from the reference's, in the reference's standard deviations, root mean square over the
        parameters.
    error_of_truth : ndarray, shape (P,)
        The same from the true parameters; NaN when they are not known.
    """

    draws: NDArray[np.int64]
    wall: Float
    cpu: Float
    r_hat: Float
    ess: Float
    error: Float
    error_of_truth: Float


def worst_r_hat(theta: Float) -> float:
    """Return the greatest R-hat of the parameters of draws (K, N, d)."""
    return max(r_hat(np.ascontiguousarray(theta[..., k])) for k in range(theta.shape[-1]))


def worst_ess(theta: Float) -> float:
    """Return the least bulk effective sample size of the parameters of draws (K, N, d)."""
    return min(bulk_ess(np.ascontiguousarray(theta[..., k])) for k in range(theta.shape[-1]))


def reference_of(theta: Float) -> Reference:
    """Summarise the draws (K, N, d) of the reference run."""
    flat = theta.reshape(-1, theta.shape[-1])
    sd = flat.std(axis=0, ddof=1)
    mcse = np.array([mcse_of_mean(np.ascontiguousarray(theta[..., k])) for k in range(theta.shape[-1])])
    return Reference(flat.mean(axis=0), sd, _rms(mcse / sd), worst_r_hat(theta), worst_ess(theta))


def learning_curve(theta: Float, wall: Float, cpu: Float, reference: Reference, truth: Float | None) -> Curve:
    """Measure the first draws of a run, for some numbers of them.

    Parameters
    ----------
    theta : ndarray, shape (K, N, d)
        Draws after burn-in.
    wall, cpu : ndarray, shape (N,)
        When each was made [s].
    reference : Reference
    truth : ndarray, shape (d,), optional
        True parameters.

    Returns
    -------
    Curve
        Evenly spaced on a logarithmic scale of time since the end of burn-in; the last point has all draws. Cost: a
        few times that of R-hat and ESS of all draws.
    """
    n_draws = theta.shape[1]
    least = min(_LEAST_DRAWS, n_draws)
    counts = np.unique(np.geomspace(least, n_draws, _POINTS).astype(np.int64))
    columns: dict[str, list[float]] = {name: [] for name in Curve._fields[3:]}
    for count in counts:
        part = theta[:, :count]
        mean = part.mean(axis=(0, 1))
        columns["r_hat"].append(worst_r_hat(part))
        columns["ess"].append(worst_ess(part))
        columns["error"].append(_rms((mean - reference.mean) / reference.sd))
        columns["error_of_truth"].append(_rms((mean - truth) / reference.sd) if truth is not None else np.nan)
    return Curve(counts, wall[counts - 1], cpu[counts - 1], *(np.array(values) for values in columns.values()))


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
