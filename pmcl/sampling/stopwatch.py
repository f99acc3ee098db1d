"""The clock of a run: it notes when each step was done and ends the run in time, for comparisons of methods."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

__all__ = ["DrawTimes", "Stopwatch", "TimeOver"]


class TimeOver(Exception):
    """The time of a stage is over; a step that is being made is dropped."""


class DrawTimes(NamedTuple):
    """When the draws of a run were made.

    Attributes
    ----------
    wall, cpu : list of float, length N
        Seconds since the start after each draw: by the clock, and of all cores together.
    burn_in, burn_in_cpu : float
        The same before the first draw.
    """

    wall: list[float]
    cpu: list[float]
    burn_in: float
    burn_in_cpu: float


@dataclass
class Stopwatch:
    """Notes the time of every step of one run, and ends its stages; it starts when it is created.

    Attributes
    ----------
    limit : float
        Seconds that the whole run may take.
    on_step : callable, optional
        Called after every step with the seconds since the start.
    clock : callable
        Returns the time [s].
    wall, cpu : list of float
        Seconds since the start after each step: those of the clock, and those of all cores together.
    deadline : float
        When :meth:`check` begins to raise TimeOver [s since the start].
    seconds, cpu_seconds : float
        Seconds from the start to :meth:`stop`: those of the clock, and those of all cores together.
    """

    limit: float = math.inf
    on_step: Callable[[float], None] | None = None
    clock: Callable[[], float] = time.perf_counter
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    deadline: float = math.inf
    seconds: float = math.nan
    cpu_seconds: float = math.nan
    _begin: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Start."""
        self._begin = (self.clock(), time.process_time())

    def now(self) -> float:
        """Return the seconds since the start."""
        return self.clock() - self._begin[0]

    def stop(self) -> None:
        """Note when the run has ended; a step that was dropped counts too."""
        self.seconds = self.now()
        self.cpu_seconds = time.process_time() - self._begin[1]

    def check(self) -> None:
        """Raise TimeOver when the deadline has passed; called before each walker's part of a step."""
        if self.deadline < math.inf and self.now() >= self.deadline:
            raise TimeOver

    def step(self) -> float:
        """Note that a step is done; return the seconds since the start."""
        self.wall.append(self.now())
        self.cpu.append(time.process_time() - self._begin[1])
        if self.on_step is not None:
            self.on_step(self.wall[-1])
        return self.wall[-1]

    def draw_times(self, n_draws: int) -> DrawTimes:
        """Return when the last `n_draws` steps were done, after the run was stopped.

        A method that notes no steps, or fewer than it returns draws, has all its draws at the end of its run.
        """
        if len(self.wall) < n_draws:
            return DrawTimes([self.seconds] * n_draws, [self.cpu_seconds] * n_draws, 0.0, 0.0)
        before = len(self.wall) - n_draws - 1
        burn_in = (self.wall[before], self.cpu[before]) if before >= 0 else (0.0, 0.0)
        return DrawTimes(self.wall[before + 1 :], self.cpu[before + 1 :], *burn_in)
