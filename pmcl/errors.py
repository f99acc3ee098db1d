"""What can go wrong, each said in one line.

Every message names what was expected, what came, where, and what to do. The command line prints it on
stderr and exits with status 2; a library user catches :class:`PmclError`.
"""

from __future__ import annotations

__all__ = [
    "CriticismError",
    "FilterError",
    "LogError",
    "MapError",
    "ModelError",
    "PmclError",
    "PosteriorError",
    "SamplingError",
]


class PmclError(ValueError):
    """Base class of the errors that pmcl raises about its input."""


class LogError(PmclError):
    """A robot log, or the recording it is converted from, is not usable."""


class MapError(PmclError):
    """A map is not usable, or does not fit the log."""


class ModelError(PmclError):
    """A model, its parameters or a model file is not usable, or does not fit the log."""


class FilterError(PmclError):
    """A particle filter met a density that is not a number, or lost every particle.

    Attributes
    ----------
    row : int or None
        The row at which every particle had weight zero, where that was so.
    """

    def __init__(self, message: str = "", row: int | None = None) -> None:
        super().__init__(message)
        self.row = row


class SamplingError(PmclError):
    """A chain cannot start, or cannot be resumed from the file given."""


class PosteriorError(PmclError):
    """A posterior is empty, or does not fit what it is used with."""


class CriticismError(PmclError):
    """A log cannot be criticised: it is too short to split, or nothing in it moves."""
