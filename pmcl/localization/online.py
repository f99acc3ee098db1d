"""Localization on a robot: one time step at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl import defaults
from pmcl.checks import check_number, check_seed, check_type, check_whole
from pmcl.errors import FilterError, LogError
from pmcl.filtering.particle_filter import make_rng
from pmcl.localization.options import FilterOptions
from pmcl.localization.recent import RecentRows
from pmcl.localization.setup import independent_readings, prepare
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.posterior.compat import Posterior

__all__ = ["OnlineLocalizer", "PoseEstimate"]

Float = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """Where the robot is, given everything up to now.

    Attributes
    ----------
    time : float
        Sample time [s].
    mean : ndarray, shape (3,)
        Mean pose [m, m, rad] in the map frame; the heading is the circular mean.
    covariance : ndarray, shape (3, 3)
        Covariance about it.
    log_score : float
        Log density of this step's readings given everything before [nat]; 0 without readings.
    effective_size : float
        Effective sample size.
    particles : int
        Number of particles.
    """

    time: float
    mean: Float
    covariance: Float
    log_score: float
    effective_size: float
    particles: int


class OnlineLocalizer:
    """A localizing filter that takes one time step after the other.

    It gives the same numbers as :func:`pmcl.localization.offline.localize` on the same rows, to the last bit, and its
    memory does not grow.

    Parameters
    ----------
    robot : RobotLog
        Any log of this robot: it tells map, mounts and channels, and where the robot may begin. Its rows are not
        used, one is enough; build it with :meth:`~pmcl.logs.robot_log.RobotLog.build` where there is no recording.
    model, posterior, method, theta, particles, seed, options
        As for :func:`pmcl.localization.offline.localize`.
    memory : int
        Rows that are kept for models whose densities look back: 2 and the first for a sensor with latency, more for
        effects that reach back farther. Effects that need all rows since the start cannot run online.

    Raises
    ------
    PmclError
        When robot, model, posterior and settings do not fit each other.

    Notes
    -----
    ``posterior`` makes the tables of all K draws at each step, which costs more than the filter itself; ``mean`` and
    ``map`` need those of one. With outliers, the greatest distance of a gross error is that of the map and of the
    readings in memory, where :func:`~pmcl.localization.offline.localize` knows the whole log.

    Examples
    --------
    >>> from pmcl.localization import OnlineLocalizer
    >>> robot = OnlineLocalizer(log, posterior=data, method="mean")
    >>> estimate = robot.update(0.1, odometry=(0.05, 0.0, 0.01), range=ranges)
    >>> estimate.mean.shape, estimate.covariance.shape
    ((3,), (3, 3))
    """

    def __init__(
        self,
        robot: RobotLog,
        model: RobotModel | None = None,
        posterior: Posterior | None = None,
        method: str = "mean",
        *,
        theta: Mapping[str, float] | None = None,
        particles: int = defaults.LOCALIZATION_PARTICLES,
        seed: int = 0,
        options: FilterOptions | None = None,
        memory: int = 8,
    ) -> None:
        seed = check_seed(seed, error=FilterError)
        check_type("robot", robot, RobotLog, error=LogError, advice="give any log of this robot")
        memory = check_whole("memory", memory, 3, error=LogError, advice="8 rows are usual")
        self._rows = RecentRows(robot, memory)
        self._rng = make_rng(seed)
        # Bound once, with everything checked, to rows without readings; later rows follow without checks.
        template = RecentRows(robot, memory)
        for time in (0.0, 1.0):
            template.add(time, np.zeros(3), {})
        self._prepared = prepare(
            template, default_model(robot) if model is None else model, posterior, method, theta, particles, options
        )

    def update(
        self,
        time: float,
        odometry: ArrayLike | None = None,
        **readings: ArrayLike | None,
    ) -> PoseEstimate:
        """Take in one time step.

        Parameters
        ----------
        time : float
            Sample time [s], later than the last.
        odometry : array_like, shape (3,)
            Displacement (forward, left, turn) since the last step, in the robot frame there [m, m, rad]; not read at
            the first step.
        **readings : array_like
            What the robot's sensors measured, by the names of the log format and in its units; NaN where nothing was
            measured, as is what is left out. ``range`` has shape (B,) [m], inf for no echo; ``landmark_range`` [m],
            ``landmark_bearing`` [rad] and ``landmark_size`` [pixel] have shape (J,).

        Returns
        -------
        PoseEstimate
            Cost: O(n) and the tables of the model; memory does not grow.

        Raises
        ------
        LogError
            When an argument is missing or impossible; nothing has changed then.
        FilterError
            When the filter has lost the robot: start again, with a start anywhere.
        """
        time = check_number("time", time, unit="s", error=LogError, advice="give the sample time")
        self._rows.add(time, odometry, readings)
        bound = self._prepared.bound.on_later_rows(self._rows)
        tracker = self._prepared.tracker
        # At the first row there is no motion yet, and effects may divide by its duration.
        with np.errstate(invalid="ignore", divide="ignore"):
            tracker.use([bound.tables(value)[0] for value in self._prepared.theta])
        row = self._rows.n_steps - 1
        counts = independent_readings(tracker.tables, row + 1)[row:]
        beliefs = tracker.run(row, row + 1, counts, self._rng, f"time {time:g} s")
        return PoseEstimate(
            float(time), beliefs.mean[0, :3], beliefs.covariance[0, :3, :3], float(beliefs.log_score[0]),
            float(beliefs.effective_size[0]), int(beliefs.particles[0]),
        )  # fmt: skip

    @property
    def particles(self) -> tuple[Float, Float]:
        """The belief itself: states (D, n) and their weights (n,), which sum to 1."""
        return self._prepared.tracker.particles()

