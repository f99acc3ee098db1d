"""The coefficient table of motion along joined logs, and how a model's tables get it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.models.starts.table import GaussianStart, PoseStart, WiderStart
from pmcl.models.tables import Tables

__all__ = ["JoinedMotion", "Seams", "joined_tables", "parts_of_joined"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class Seams(NamedTuple):
    """Where joined logs begin, but for the first of them.

    Attributes
    ----------
    row : ndarray of int, shape (K,)
        First row of each.
    start : GaussianStart, PoseStart or WiderStart
        A belief about the first state of one of them; of the others only mean, std and log density differ.
    mean, std : ndarray, shape (K, D)
        Those of each.
    log_density : ndarray, shape (K,)
        That of the uniform parts of each belief; not used where all are Gaussian.
    """

    row: Int
    start: GaussianStart | PoseStart | WiderStart
    mean: Float
    std: Float
    log_density: Float


class JoinedMotion(NamedTuple):
    """Motion that begins anew at the seams of joined logs.

    Attributes
    ----------
    motion : NamedTuple
        Motion between all other rows.
    seams : Seams
        Where and how the robot begins anew.
    """

    motion: NamedTuple
    seams: Seams


def joined_tables(tables: Tables, seams: Seams) -> Tables:
    """Return tables in which the motion begins anew at seams.

    Parameters
    ----------
    tables : Tables
        Tables of joined logs, with effects in them: a state may have more components than a pose.
    seams : Seams
        The seams. Of the beliefs only the poses count.

    Returns
    -------
    Tables
        Components beyond the pose begin at each seam as they begin at the first row.
    """
    start, of_pose = tables.start, seams.start.pose if isinstance(seams.start, WiderStart) else seams.start
    mean, std = seams.mean[:, :3], seams.std[:, :3]
    if isinstance(start, GaussianStart):
        more = GaussianStart(start.mean[3:], start.std[3:])
    elif isinstance(start, WiderStart):
        more = GaussianStart(start.mean, start.std)
    else:
        more = GaussianStart(np.empty(0), np.empty(0))
    mean, std = (
        np.ascontiguousarray(np.hstack([each, np.tile(further, (len(each), 1))]))
        for each, further in ((mean, more.mean), (std, more.std))
    )
    if isinstance(of_pose, GaussianStart):
        belief: GaussianStart | PoseStart | WiderStart = GaussianStart(mean[0], std[0])
    else:
        belief = WiderStart(of_pose, more.mean, more.std) if more.mean.size else of_pose
    return tables._replace(motion=JoinedMotion(tables.motion, seams._replace(start=belief, mean=mean, std=std)))


def parts_of_joined(tables: Tables) -> tuple[Tables, Seams | None]:
    """Return tables with the motion between the seams alone, and the seams; None where there are none."""
    if not isinstance(tables.motion, JoinedMotion):
        return tables, None
    return tables._replace(motion=tables.motion.motion), tables.motion.seams
