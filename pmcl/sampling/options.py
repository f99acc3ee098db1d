"""The options of a calibration run that are the same for every method: sizes, seed, threads, checkpoint, time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pmcl import defaults
from pmcl.sampling.stopwatch import Stopwatch

__all__ = ["Progress", "RunOptions", "SettingValue"]

SettingValue = str | int | float | bool
Progress = bool | Callable[[str, int, int], None]
"""Whether progress bars are shown, or who is told after each step: the stage's name, steps done, and steps in all."""


@dataclass(frozen=True)
class RunOptions:
    """How a calibration is run, whatever its method.

    Attributes
    ----------
    draws : int
        Draws of each chain after burn-in. A stopwatch may end the run before.
    chains : int
        Number of chains. A method that needs more takes more, and says so.
    seed : int
        All randomness follows from it, whatever the pool.
    trajectories : int
        Trajectories of each chain that are kept.
    pool : object with a `map` method, optional
        Runs the chains of each step; threads on all cores when left out.
    checkpoint : str, optional
        File to which the run is written every few seconds, and when an error or Ctrl-C ends it.
    resume : bool
        Whether an existing checkpoint is continued; the result is that of an uninterrupted run.
    progress : bool or callable
        See :data:`Progress`.
    stopwatch : Stopwatch, optional
        Notes the time of every step, and ends the run when its time is over; burn-in is shortened when it would take
        more than half of it. How many draws there are then depends on the machine. Not with a checkpoint.
    attributes : mapping of str to scalar
        Further attributes of the result.
    """

    draws: int = defaults.DRAWS
    chains: int = defaults.CHAINS
    seed: int = 0
    trajectories: int = defaults.TRAJECTORIES
    pool: Any = None
    checkpoint: str | None = None
    resume: bool = False
    progress: Progress = False
    stopwatch: Stopwatch | None = None
    attributes: Mapping[str, SettingValue] = field(default_factory=dict)

    @property
    def limited(self) -> bool:
        """Whether a stopwatch may end the run."""
        return self.stopwatch is not None

    @property
    def keep_every(self) -> int:
        """Every how many draws a trajectory is kept."""
        return max(1, self.draws // max(self.trajectories, 1))
