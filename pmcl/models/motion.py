"""The door of a motion model's room: what generic code asks a motion model.

A motion model is one class that derives from :class:`Motion`, registered by the name that model files have for it. Its
table may be one that exists, such as that of noisy increments; then every effect of the motion applies to it. The
compiled functions of a table of its own are registered with :mod:`pmcl.engine.contract`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter
from pmcl.models.part import BoundPart
from pmcl.registry import MOTIONS, register, registered

__all__ = ["Motion", "motions", "register_motion"]

_Class = TypeVar("_Class", bound=type)


class Motion(ABC):
    """A motion model; a class derives from it for each kind of motion, and can be made without arguments.

    Attributes
    ----------
    summary : str
        What it is, in a few words, for the comments of model files.
    moves_sideways : bool
        Whether it is of robots that can move across their heading.
    aside_by_turning : bool
        Whether a command to go aside stands for a turn, a drive and a turn back, so that it is no small command.
    """

    summary: ClassVar[str] = ""
    moves_sideways: ClassVar[bool] = False
    aside_by_turning: ClassVar[bool] = False

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The motion's parameters, in the order in which its table function takes them."""

    @abstractmethod
    def bind(self, log: RobotLog) -> BoundPart:
        """Prepare for one log; raises ModelError when the log lacks what the motion needs."""


def motions() -> dict[str, Any]:
    """Return all registered classes of motion models by the names that model files have for them."""
    return registered(MOTIONS)


def register_motion(name: str) -> Callable[[_Class], _Class]:
    """Register a class of motion models for this process; an installed package uses an entry point instead.

    Parameters
    ----------
    name : str
        What model files call it, e.g. ``"increment"`` in ``motion = "increment"``.

    Returns
    -------
    callable
        A decorator for the class.

    Raises
    ------
    ModelError
        When the name is taken.
    """

    def decorate(motion: _Class) -> _Class:
        register(MOTIONS, name, motion)
        return motion

    return decorate
