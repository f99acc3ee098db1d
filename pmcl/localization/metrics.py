"""How far an estimated track is from a reference: absolute and relative errors, and whether its uncertainty is honest.

Poses are (x, y, heading) [m, m, rad] in the map frame; headings are compared on the circle. Rows in which the reference
is not known (NaN) give NaN, and do not count in the summaries.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from pmcl.errors import PmclError
from pmcl.geometry import between, wrap

__all__ = [
    "PoseErrors",
    "coverage",
    "nees",
    "pose_errors",
    "relative_errors",
    "relative_errors_by_distance",
    "rmse",
]

Float = NDArray[np.float64]


class PoseErrors(NamedTuple):
    """Errors of poses.

    Attributes
    ----------
    position : ndarray, shape (..., T)
        Distance between estimate and reference [m], >= 0.
    heading : ndarray, shape (..., T)
        Estimate minus reference [rad], in [-pi, pi).
    """

    position: Float
    heading: Float


def pose_errors(estimate: ArrayLike, reference: ArrayLike) -> PoseErrors:
    """Return the absolute error of each pose.

    Parameters
    ----------
    estimate : array_like, shape (..., T, 3)
        One or several tracks.
    reference : array_like, shape (T, 3)
        The truth, NaN where unknown.

    Raises
    ------
    PmclError
        When lengths differ.
    """
    estimate, reference = _poses(estimate, reference)
    offset = estimate[..., :2] - reference[:, :2]
    return PoseErrors(np.hypot(offset[..., 0], offset[..., 1]), wrap(estimate[..., 2] - reference[:, 2]))


def relative_errors(estimate: ArrayLike, reference: ArrayLike, lag: int = 1) -> PoseErrors:
    """Return the error of the motion over `lag` rows: drift, without the offset that a track may have as a whole.

    Parameters
    ----------
    estimate, reference : array_like, shape (..., T, 3) and (T, 3)
        Tracks.
    lag : int
        Rows between the two poses that are compared, 1 to T - 1.

    Returns
    -------
    PoseErrors
        Arrays of shape (..., T - lag): distance and turn between the estimated and the true motion, in the frame of
        the first pose (the relative pose error of Sturm et al., IROS 2012).

    Raises
    ------
    PmclError
        When lengths differ, or `lag` is not within the track.
    """
    estimate, reference = _poses(estimate, reference)
    if not 1 <= lag < len(reference):
        raise PmclError(f"expected a lag of 1 to {len(reference) - 1} rows, got {lag}: choose one within the track")
    rows = np.arange(len(reference) - lag)
    return _between_rows(estimate, reference, rows, rows + lag)


def relative_errors_by_distance(estimate: ArrayLike, reference: ArrayLike, distance: float) -> PoseErrors:
    """Return the error of the motion over stretches of the reference path of at least `distance`.

    Parameters
    ----------
    estimate, reference : array_like, shape (..., T, 3) and (T, 3)
        Tracks.
    distance : float
        Length of a stretch along the reference path [m], > 0.

    Returns
    -------
    PoseErrors
        Arrays of shape (..., M), one for each row from which the path goes on that far. While the reference is
        unknown the path does not grow.

    Raises
    ------
    PmclError
        When lengths differ, or `distance` is not positive.
    """
    estimate, reference = _poses(estimate, reference)
    if not distance > 0.0:
        raise PmclError(f"expected a distance > 0 m, got {distance:g}: choose a longer stretch")
    steps = np.hypot(*np.diff(reference[:, :2], axis=0).T)
    length = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    first = np.arange(len(reference))
    last = np.searchsorted(length, length + distance)
    far_enough = last < len(reference)
    return _between_rows(estimate, reference, first[far_enough], last[far_enough])


def nees(mean: ArrayLike, covariance: ArrayLike, reference: ArrayLike, dof: int = 2) -> Float:
    """Return the normalised estimation error squared: error' covariance^-1 error, chi-square when the belief is right.

    Parameters
    ----------
    mean : array_like, shape (..., T, 3)
        Mean poses.
    covariance : array_like, shape (..., T, 3, 3)
        Their covariances.
    reference : array_like, shape (T, 3)
        The truth, NaN where unknown.
    dof : {2, 3}
        2 for the position, 3 with the heading.

    Returns
    -------
    ndarray, shape (..., T)
        inf where a covariance is singular: a belief that excludes everything.

    Raises
    ------
    PmclError
        When lengths differ, or `dof` is neither 2 nor 3.
    """
    if dof not in (2, 3):
        raise PmclError(f"expected 2 degrees of freedom (position) or 3 (pose), got {dof}: choose one of them")
    mean, reference = _poses(mean, reference)
    error = mean - reference
    error[..., 2] = wrap(error[..., 2])
    error, block = error[..., :dof], np.asarray(covariance, dtype=float)[..., :dof, :dof]
    sound = np.linalg.det(block) > 0.0
    safe = np.where(sound[..., None, None], block, np.eye(dof))
    value = (error * np.linalg.solve(safe, error[..., None])[..., 0]).sum(axis=-1)
    return np.asarray(np.where(sound | np.isnan(value), value, np.inf))


def coverage(values: ArrayLike, level: float = 0.95, dof: int = 2) -> float:
    """Return the share of rows whose true pose lies inside the ellipse of probability `level`.

    Parameters
    ----------
    values : array_like
        From :func:`nees`; NaN does not count.
    level : float
        Probability of the ellipse.
    dof : int
        The degrees of freedom that `values` were computed with.

    Returns
    -------
    float
        About `level` for an honest filter; NaN when no row counts.
    """
    values = np.asarray(values, dtype=float)
    known = values[~np.isnan(values)]
    return float(np.mean(known <= stats.chi2.ppf(level, dof))) if known.size else float("nan")


def rmse(errors: ArrayLike) -> Float:
    """Return the root mean square along the last axis; rows of unknown truth (NaN) do not count, NaN if none does."""
    errors = np.asarray(errors, dtype=float)
    known = ~np.isnan(errors)
    with np.errstate(invalid="ignore"):
        mean = np.where(known, errors, 0.0) ** 2 @ np.ones(errors.shape[-1]) / known.sum(axis=-1)
    return np.asarray(np.sqrt(mean))


def _between_rows(estimate: Float, reference: Float, first: NDArray[np.int64], last: NDArray[np.int64]) -> PoseErrors:
    estimated = between(estimate[..., first, :], estimate[..., last, :])
    true = between(reference[first], reference[last])
    error = between(np.broadcast_to(true, estimated.shape), estimated)
    return PoseErrors(np.hypot(error[..., 0], error[..., 1]), error[..., 2])


def _poses(estimate: ArrayLike, reference: ArrayLike) -> tuple[Float, Float]:
    estimate, reference = np.asarray(estimate, dtype=float), np.asarray(reference, dtype=float)
    if reference.ndim != 2 or estimate.ndim < 2 or estimate.shape[-2:] != reference.shape or reference.shape[1] != 3:
        raise PmclError(
            f"expected estimates of shape (..., T, 3) and a reference of shape (T, 3), got {estimate.shape} and "
            f"{reference.shape}: give one pose for each row"
        )
    return estimate, reference
