"""The door of a motion model's room: what generic code asks a motion model.

A motion model is a class with the methods of :class:`~pmcl.models.part.Part`, registered by a name for model files.
Its table's compiled functions are registered with :mod:`pmcl.engine.contract`.
"""

from __future__ import annotations

from typing import Any

from pmcl.registry import MOTIONS, register, registered

__all__ = ["motions", "register_motion"]


def motions() -> dict[str, Any]:
    """Return all registered classes of motion models by the names that model files have for them."""
    return registered(MOTIONS)


def register_motion(name: str) -> Any:
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

    def decorate(motion: Any) -> Any:
        register(MOTIONS, name, motion)
        return motion

    return decorate
