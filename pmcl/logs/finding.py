"""What a check of a log found: a name, how bad it is, and one sentence for people."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

__all__ = ["Finding", "warn_of"]

_logger = logging.getLogger("pmcl.preflight")


@dataclass(frozen=True)
class Finding:
    """Something in a log that a sound log does not have.

    Attributes
    ----------
    name : str
        Short name, e.g. ``"bearings-in-degrees"``.
    level : {"impossible", "implausible"}
        Whether no log can have this, or only hardly any.
    mistake : bool
        Whether a named mistake explains the log better than what the log says. A posterior of such a log is not to be
        trusted, however well its chains agree.
    message : str
        One sentence: what was found, with numbers, and what to do.
    """

    name: str
    level: Literal["impossible", "implausible"]
    mistake: bool
    message: str

    def as_dict(self) -> dict[str, str | bool]:
        """Return name, level, mistake and message, as files keep them."""
        return asdict(self)


def warn_of(findings: Iterable[Finding], where: str) -> None:
    """Write each finding as a warning to the logger ``pmcl.preflight``.

    Parameters
    ----------
    findings : iterable of Finding
        What was found.
    where : str
        File or call that the log came from.
    """
    for finding in findings:
        _logger.warning("warning: %s: %s (%s)", where, finding.message, finding.name)
