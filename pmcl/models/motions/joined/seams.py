"""The seams of a joined log."""

from __future__ import annotations

import numpy as np

from pmcl.logs.joined import first_rows, starts_of_joined
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.joined.table import Seams
from pmcl.models.starts.belief import StartBelief
from pmcl.models.starts.table import GaussianStart

__all__ = ["seams_of"]


def seams_of(log: RobotLog) -> Seams | None:
    """Return where the robot begins anew in a joined log, and the beliefs there; None for a log that is not joined.

    Raises
    ------
    ModelError
        When a start belief cannot be expressed by a density.
    """
    rows = first_rows(log)
    if not rows.size:
        return None
    starts = [StartBelief().bind(start).fixed for start in starts_of_joined(log)]
    # One kind of belief serves all: that of a pose that may be anywhere, if one of them may.
    belief = next((start for start in starts if not isinstance(start, GaussianStart)), starts[0])
    return Seams(
        rows, belief, np.array([start.mean for start in starts]), np.array([start.std for start in starts]),
        np.array([0.0 if isinstance(start, GaussianStart) else start.log_density for start in starts]),
    )  # fmt: skip
