"""Particle filter, smoothing and conditional SMC for one log under one theta."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import DensityError, FilterError
from pmcl.filtering.blocks import redraw_in_blocks
from pmcl.filtering.kernels import smc
from pmcl.filtering.kernels.backward import WEIGHED
from pmcl.filtering.kernels.resampling import SCHEMES, AnyScheme
from pmcl.interrupts import check_interrupt
from pmcl.models.tables import Tables

__all__ = [
    "MOST_EXCHANGEABLE", "MOST_KEPT_STATES", "FilterPass", "PathUpdate", "draw_paths", "draw_paths_beside", "draw_set",
    "log_joint", "make_rng", "run_filter", "update_path",
]  # fmt: skip

Float = NDArray[np.float64]
Kernel = Literal["smoothing", "conditional"]

MOST_EXCHANGEABLE = WEIGHED
"""With at most so many particles :func:`draw_set` draws trajectories among which the given one is as any other."""

MOST_KEPT_STATES = 8_000_000
"""Particles times rows that :func:`update_path` holds at a time: 36 bytes each where states are poses, 288 MB for each
chain. Longer logs are filtered twice, in blocks
(:mod:`pmcl.filtering.blocks`)."""


def make_rng(seed: int | np.random.SeedSequence | None = None) -> np.random.Generator:
    """Return the generator that the kernels take: SFC64, fast and of good quality."""
    return np.random.Generator(np.random.SFC64(seed))


@dataclass(frozen=True)
class FilterPass:
    """The result of a particle filter.

    Attributes
    ----------
    log_evidence : float
        Log of the unbiased estimate of p(readings | theta).
    particles : ndarray, shape (T, D, n)
        States at each time, after propagation.
    log_weights : ndarray, shape (T, n)
        Their unnormalised log weights at that time, before resampling.
    log_increments : ndarray, shape (T,)
        Log predictive density of the readings at each time; they sum to the evidence.
    effective_size : ndarray, shape (T,)
        Effective sample size, 1 to n.
    ancestors : ndarray of int, shape (T, n)
        Which particle of the time before each one comes from; undefined at the first time.
    """

    log_evidence: float
    particles: Float
    log_weights: Float
    log_increments: Float
    effective_size: Float
    ancestors: NDArray[np.uint32]

    def weights(self, t: int) -> Float:
        """Return the normalised weights at time t, shape (n,)."""
        w = np.exp(self.log_weights[t] - self.log_weights[t].max())
        return np.asarray(w / w.sum())

    def mean(self) -> Float:
        """Return the weighted mean state at each time, (T, D).

        Headings are on the real line here, so a plain mean is right while the particles agree; for a belief spread
        over the circle use :func:`pmcl.geometry.circular_mean`.
        """
        return np.array([self.particles[t] @ self.weights(t) for t in range(self.particles.shape[0])])


def raise_outcome(status: int, t: int, what: str) -> None:
    """Raise an error when a compiled pass ended early.

    Parameters
    ----------
    status : int
        Outcome of the pass, one of the constants of :mod:`pmcl.filtering.kernels.smc`.
    t : int
        The row at which it ended.
    what : str
        Name of the algorithm, with which the message begins.

    Raises
    ------
    FilterError
        When every particle had weight zero, or no particle could be an ancestor.
    DensityError
        When a density was not a number.
    """
    if status == smc.ALL_ZERO:
        raise FilterError(
            f"{what}: at row {t} every particle has weight zero, so the filter has lost the robot; "
            "use more particles, a wider start belief, or larger noise",
            row=t,
        )
    if status == smc.NOT_A_NUMBER:
        raise DensityError(
            f"{what}: at row {t} a density is not a number; check the coefficient tables of the model at that row",
            row=t,
        )
    if status == smc.NO_ANCESTOR:
        raise FilterError(
            f"{what}: no particle at row {t} can lead to the state at row {t + 1}; "
            "the motion model has no transition density in some direction, give it noise in every direction"
        )


def run_filter(
    tables: Tables,
    n_steps: int,
    n_particles: int,
    rng: np.random.Generator,
    *,
    scheme: str = "multinomial",
    threshold: float = 1.0,
) -> FilterPass:
    """Run a bootstrap particle filter over one log (eqs. 1 and 2).

    Parameters
    ----------
    tables : Tables
        Coefficients of the model for this log.
    n_steps : int
        Number of rows T.
    n_particles : int
        Number of particles n, at least 2.
    rng : numpy.random.Generator
        Source of randomness, see :func:`make_rng`.
    scheme : {"multinomial", "systematic", "stratified", "residual"}
        How ancestors are drawn; the paper's is multinomial.
    threshold : float
        Resample where the effective sample size is at most ``threshold * n``: 1 always, 0 never.

    Returns
    -------
    FilterPass
        Cost: O(T n) times the cost of one reading's density; memory O(T n).

    Raises
    ------
    FilterError
        When every particle gets weight zero, or n < 2.
    DensityError
        When a density is not a number.
    """
    check_interrupt()
    check_particles(n_particles)
    if scheme not in SCHEMES:
        raise FilterError(f"expected a resampling scheme out of {sorted(SCHEMES)}, but got '{scheme}'")
    status, t, log_evidence, particles, log_weights, steps, ancestors = smc.filter_pass(
        tables, rng, n_steps, n_particles, AnyScheme(SCHEMES[scheme]), float(threshold)
    )
    raise_outcome(status, t, "particle filter")
    return FilterPass(log_evidence, particles, log_weights, steps[:, 0], steps[:, 1], ancestors)


def check_particles(n_particles: int) -> None:
    """Raise FilterError unless there are at least two particles."""
    if n_particles < 2:
        raise FilterError(f"expected at least 2 particles, but got {n_particles}; 25 to 1000 are usual")


def draw_paths(tables: Tables, filtered: FilterPass, n_paths: int, rng: np.random.Generator) -> Float:
    """Draw trajectories backward from a filter pass (eqs. 3 to 7), shape (n_paths, T, D).

    Each has the law of backward sampling; where few particles could have been the ancestor, trajectories of one pass
    have more states in common than independent draws would. Cost: O(T) for each path.

    Parameters
    ----------
    tables : Tables
        Coefficients of the model for this log.
    filtered : FilterPass
        The filter pass.
    n_paths : int
        Number of trajectories.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (n_paths, T, D)

    Raises
    ------
    FilterError
        When no particle can be the ancestor of a drawn state.
    """
    status, t, paths = smc.sample_backward(
        tables, rng, filtered.particles, filtered.log_weights, filtered.ancestors, n_paths
    )
    raise_outcome(status, t, "backward sampling")
    return np.asarray(paths)


def draw_paths_beside(
    tables: Tables, path: Float, n_particles: int, n_paths: int, rng: np.random.Generator
) -> Float:
    """Draw trajectories from a filter in which one particle follows a given trajectory (conditional SMC).

    If the given trajectory is a draw given all readings, each new one is such a draw, for any number of particles
    (Andrieu, Doucet, Holenstein 2010; backward sampling: Whiteley 2010). Where all other particles miss what was read,
    in a plain filter the least wrong of them would stand for the robot; here the given trajectory does.

    Parameters
    ----------
    tables : Tables
        Coefficients of the model for this log.
    path : ndarray, shape (T, D)
        The given trajectory, headings not wrapped; it is not changed.
    n_particles : int
        Number of particles n, at least 2.
    n_paths : int
        Number of trajectories that are drawn.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (n_paths, T, D)

    Raises
    ------
    FilterError
        When every particle gets weight zero, or n < 2.
    DensityError
        When a density is not a number.
    """
    check_interrupt()
    check_particles(n_particles)
    status, t, _, particles, log_weights, _, ancestors = smc.conditional_pass(tables, rng, path, n_particles)
    raise_outcome(status, t, "conditional filter")
    status, t, paths = smc.sample_backward(tables, rng, particles, log_weights, ancestors, n_paths)
    raise_outcome(status, t, "backward sampling")
    return np.asarray(paths)


class PathUpdate(NamedTuple):
    """How one draw of a trajectory went.

    Attributes
    ----------
    log_evidence : float
        Estimate of log p(readings | theta) [nat]; unbiased with the smoothing kernel only.
    effective_share : float
        Mean effective sample size over rows with readings, as a share of n.
    changed_share : float
        Share of states that differ from the previous trajectory.
    succeeded : bool
        False when every particle had weight zero at some row; the trajectory was then left as it was.
    """

    log_evidence: float
    effective_share: float
    changed_share: float
    succeeded: bool


def update_path(
    tables: Tables, path: Float, n_steps: int, n_particles: int, rng: np.random.Generator, kernel: Kernel
) -> PathUpdate:
    """Replace the first `n_steps` states of `path` (T, D) in place by one draw.

    Parameters
    ----------
    tables : Tables
        Coefficients at the current theta.
    path : ndarray, shape (T, D)
        The trajectory. ``conditional`` needs a valid one; ``smoothing`` does not read it.
    n_steps : int
        Rows to use (all, or fewer while data is being included).
    n_particles : int
        Number of particles n.
    rng : numpy.random.Generator
        Source of randomness.
    kernel : {"smoothing", "conditional"}
        ``smoothing``: filter forward, sample backward (the paper's; exact only as n grows). ``conditional``:
        conditional SMC with backward sampling (exact for any n; Whiteley 2010, Lindsten and Schon 2013).

    Returns
    -------
    PathUpdate

    Raises
    ------
    FilterError
        When a transition has no density.
    DensityError
        When a density is not a number.
    """
    if n_particles * n_steps <= MOST_KEPT_STATES:
        status, t, log_evidence, effective, changed = smc.redraw_path(
            tables, rng, n_steps, n_particles, kernel == "conditional", path
        )
    else:
        # Half of it for a block, half for what is kept of the others.
        status, t, log_evidence, effective, changed = redraw_in_blocks(
            tables, rng, n_steps, n_particles, kernel == "conditional", path, MOST_KEPT_STATES // (2 * n_particles)
        )
    if status == smc.ALL_ZERO:
        return PathUpdate(-math.inf, 0.0, 0.0, succeeded=False)
    raise_outcome(status, t, f"{kernel} sweep")
    return PathUpdate(log_evidence, effective / n_particles, changed / n_steps, succeeded=True)


def draw_set(tables: Tables, path: Float, n_paths: int, n_particles: int, rng: np.random.Generator) -> Float | None:
    """Draw a set of trajectories by one pass of conditional SMC with backward sampling.

    If `path` has the law p(path | readings, theta), then it and the drawn ones are exchangeable under that law.

    Parameters
    ----------
    tables : Tables
        Coefficients of one log at theta.
    path : ndarray, shape (T, D)
        The trajectory that the pass keeps; it is left as it is.
    n_paths : int
        Number of trajectories M.
    n_particles : int
        Number of particles n, from 2 to :data:`MOST_EXCHANGEABLE`. With more, backward sampling begins at a particle's
        own ancestor, which ties a trajectory to those of the same pass.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (M, T, D), or None
        None when every particle had weight zero at some row. Cost: O(T n) and O(T n) for each trajectory.

    Raises
    ------
    FilterError
        When a density is not a number, a transition has no density, or n is not usable.
    """
    if not 2 <= n_particles <= MOST_EXCHANGEABLE:
        raise FilterError(
            f"expected 2 to {MOST_EXCHANGEABLE} particles for a set of exchangeable trajectories, but got "
            f"{n_particles}; 25 are usual"
        )
    try:
        return draw_paths_beside(tables, path, n_particles, n_paths, rng)
    except FilterError as error:
        if error.row is None:  # no row is impossible, something else is wrong
            raise
        return None


def log_joint(tables: Tables, path: Float) -> float:
    """Return log p(path, readings | theta), eq. 16 without the prior of theta.

    Parameters
    ----------
    tables : Tables
        Coefficients of one log under theta.
    path : ndarray, shape (T, D)
        A trajectory; T may be less than the log's, and only its rows count then.

    Returns
    -------
    float
        Cost: O(T).
    """
    return float(smc.joint_terms(tables, path)[0])
