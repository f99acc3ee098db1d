"""When each step of a run was done, and when to stop: what comparing methods by their time needs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

__all__ = ["Stopwatch", "TimeOver"]


class TimeOver(Exception):
    """The time of a stage is over; a step that is being made is dropped."""


@dataclass
class Stopwatch:
    """Notes the time of every step of one run, and ends its stages; it starts when it is made.

    Attributes
    ----------
    limit : float
        Seconds that the whole run may take.
    tell : callable, optional
        Called after every step with the seconds since the start.
    clock : callable
        Returns the time [s].
    wall, cpu : list of float
        Seconds since the start after each step: those of the clock, and those of all cores together.
    deadline : float
        When :meth:`check` begins to raise TimeOver [s since the start].
    seconds : float
        Seconds from the start to :meth:`stop`.
    """

    limit: float = math.inf
    tell: Callable[[float], None] | None = None
    clock: Callable[[], float] = time.perf_counter
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    deadline: float = math.inf
    seconds: float = math.nan
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

    def check(self) -> None:
        """Raise TimeOver when the deadline has passed; called before each walker's part of a step."""
        if self.deadline < math.inf and self.now() >= self.deadline:
            raise TimeOver

    def step(self) -> float:
        """Note that a step is done; return the seconds since the start."""
        self.wall.append(self.now())
        self.cpu.append(time.process_time() - self._begin[1])
        if self.tell is not None:
            self.tell(self.wall[-1])
        return self.wall[-1]
