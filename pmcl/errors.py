"""What can go wrong, each said in one line.

Every message names what was expected, what came, where, and what to do. The command line prints it on
stderr and exits with status 2; a library user catches :class:`PmclError`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "ConversionError",
    "CriticismError",
    "DensityError",
    "FilterError",
    "LogError",
    "MapError",
    "ModelError",
    "PmclError",
    "PosteriorError",
    "SamplingError",
    "did_you_mean",
    "one_line",
]


# Similarity (difflib's ratio, 0 to 1) from which on a known name is offered in place of an unknown one. At 0.75 a word
# of eight letters may have two of them wrong: "rnge-bias" is near "range-bias" (0.95), "wheel-radius" is not near
# "wheel-slip" (0.64).
_NEAR = 0.75

# Letters of a message. Those that pmcl writes itself have up to 400, and a path may have some hundred.
_LONGEST = 900


def did_you_mean(given: str, known: Iterable[str], otherwise: str) -> str:
    """Advise on an unknown name: the known name that it is a misspelling of, or else `otherwise`.

    Parameters
    ----------
    given : str
        What came.
    known : iterable of str
        What would have been understood.
    otherwise : str
        The advice when no known name is near.

    Returns
    -------
    str
        E.g. ``"did you mean 'range-bias'?"``.
    """
    near = difflib.get_close_matches(str(given), list(known), 1, cutoff=_NEAR)
    return f"did you mean '{near[0]}'?" if near else otherwise


def one_line(message: str) -> str:
    """Bring a message into one line of bounded length: what it quotes may hold line breaks, and thousands of letters.

    Parameters
    ----------
    message : str

    Returns
    -------
    str
        The middle of a long message is left out.
    """
    line = " ".join(message.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 3 :]}"


class PmclError(ValueError):
    """Base class of the errors that pmcl raises about its input; the message is always one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class LogError(PmclError):
    """A robot log, or the recording it is converted from, is not usable."""


class MapError(PmclError):
    """A map is not usable, or does not fit the log."""


class ModelError(PmclError):
    """A model, its parameters or a model file is not usable, or does not fit the log."""


class DensityError(PmclError):
    """A log density is not a number, which means a mistake in a model, an effect or a log, and never bad luck.

    It is no :class:`FilterError`, because a search that tries something else after a lost filter must not go on after
    this.

    Attributes
    ----------
    row : int or None
        The row at which it is not a number, where that is known.
    """

    def __init__(self, message: str = "", row: int | None = None) -> None:
        super().__init__(message)
        self.row = row


class FilterError(PmclError):
    """A particle filter lost every particle, or cannot be run.

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


class ConversionError(PosteriorError):
    """All was sampled, but the draws could not be made a posterior; the message says where they are.

    Attributes
    ----------
    chains : object
        The draws as plain arrays (:class:`pmcl.sampling.chains.Chains`); for a point estimate, the estimate.
    """

    def __init__(self, message: str = "", chains: object = None) -> None:
        super().__init__(message)
        self.chains = chains


class CriticismError(PmclError):
    """A log cannot be criticised: it is too short to split, or nothing in it moves."""
