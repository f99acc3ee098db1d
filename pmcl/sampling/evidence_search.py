"""The theta of greatest evidence by the particle filter, with the same random numbers at every theta."""

from __future__ import annotations

import contextlib
import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.errors import SamplingError
from pmcl.filtering.estimated_path import plausible_theta
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.point_estimates import standard_errors
from pmcl.sampling.pseudo_marginal import BootstrapEvidence, draw_numbers
from pmcl.sampling.stopwatch import Stopwatch, TimeOver
from pmcl.sampling.transforms import Unconstrained

__all__ = ["most_evident"]

Float = NDArray[np.float64]

# Edge of the first simplex in unconstrained parameters: a third of a noise.
_EDGE = 0.3
# The quadratic is fitted to so many points for each of its coefficients, spread by this around the maximum.
_POINTS, _SPREAD = 4, 0.2
_IMPOSSIBLE = 1e10


def most_evident(
    bound: BoundModel, *, particles: int, evaluations: int, seed: int, stopwatch: Stopwatch
) -> tuple[Float, Float | None]:
    """Search for the maximum of the estimated evidence.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    particles : int
        Number of particles.
    evaluations : int
        Estimates that the search may use; fewer when the stopwatch's time is over.
    seed : int
        All randomness follows from it.
    stopwatch : Stopwatch
        May end the search.

    Returns
    -------
    theta, standard_error : ndarray, shape (d,)
        Errors are None where the evidence has no maximum there that a quadratic could fit.

    Raises
    ------
    SamplingError
        When the readings have no probability wherever the search looked.
    """
    rng, transform = make_rng(np.random.SeedSequence((seed, 43))), Unconstrained(bound.parameters)
    numbers, estimate = draw_numbers(rng, 1), BootstrapEvidence(bound)
    start = transform.to_line(plausible_theta(bound, rng))
    best: list[tuple[float, Float]] = []

    def log_evidence(u: Float) -> float:
        theta = transform.from_line(np.asarray(u, dtype=float))[0]
        if not math.isfinite(bound.log_prior(theta)):
            return -math.inf
        return estimate(theta, particles, numbers, ordered=True).log_evidence

    def cost(u: Float) -> float:
        value = log_evidence(u)
        if best and stopwatch.now() >= 0.7 * stopwatch.limit:
            raise TimeOver
        if math.isfinite(value) and (not best or value > best[-1][0]):
            best.append((value, np.array(u, dtype=float)))
        return -value if math.isfinite(value) else _IMPOSSIBLE

    simplex = np.vstack([start, start + _EDGE * np.eye(start.size)])
    with contextlib.suppress(TimeOver):
        optimize.minimize(
            cost, start.tolist(), method="Nelder-Mead",
            options={"maxfev": evaluations, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-2},
        )  # fmt: skip
    if not best:
        raise SamplingError(
            "the readings have no probability wherever the search looked; use more particles, or a model with outliers"
        )
    u = best[-1][1]
    count = _POINTS * (u.size + 1) * (u.size + 2) // 2
    points = _SPREAD * rng.standard_normal((count, u.size))
    values = np.array([log_evidence(u + point) for point in points])
    return transform.from_line(u)[0], _quadratic_errors(transform, u, points, values)


def _quadratic_errors(transform: Unconstrained, u: Float, points: Float, values: Float) -> Float | None:
    """Return standard errors from the quadratic that fits the evidences `values` (N,) at u + `points` (N, d) best."""
    usable = np.isfinite(values)
    first, second = np.triu_indices(u.size)
    design = np.column_stack([np.ones(len(points)), points, points[:, first] * points[:, second]])[usable]
    if len(design) <= design.shape[1]:
        return None
    # Near the maximum a quadratic is a better likeness.
    weight = np.exp(0.25 * (values[usable] - values[usable].max()))
    fitted = np.linalg.lstsq(design * weight[:, None], values[usable] * weight, rcond=None)[0][1 + u.size :]
    information = np.zeros((u.size, u.size))
    information[first, second] = -fitted
    return standard_errors(transform, u, information + information.T)
