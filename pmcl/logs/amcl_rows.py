"""Which scans become rows, and which of their rays stay: as AMCL gathers them.

AMCL does not use every scan. It waits until the robot has moved by some distance or angle, because neighbouring scans
say almost the same. The noise parameters of its motion model are those of such a step, so a log that is meant for AMCL
takes its rows in the same way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.checks import check_choice, check_number, check_whole
from pmcl.defaults import UPDATE_MIN_A, UPDATE_MIN_D, UPDATE_RULES
from pmcl.errors import LogError
from pmcl.geometry import wrap
from pmcl.logs.stream_checks import numbers, require_same_length, table_of
from pmcl.logs.validation import fail

__all__ = ["amcl_rows", "thinned"]


def amcl_rows(
    poses: ArrayLike,
    update_min_d: float = UPDATE_MIN_D,
    update_min_a: float = UPDATE_MIN_A,
    rule: str = "nav2",
    *,
    laser: ArrayLike | None = None,
) -> NDArray[np.int64]:
    """Choose the scans that AMCL would use.

    Parameters
    ----------
    poses : array_like, shape (N, 3)
        Pose of the robot in the odometry's fixed frame at each scan [m, m, rad], in order of time.
    update_min_d : float, optional
        Distance that the robot must have moved since the last used scan [m].
    update_min_a : float, optional
        Angle that it must have turned [rad]; either is enough. When both are zero, every scan is used.
    rule : {"nav2", "euclidean"}, optional
        ``"nav2"``: a scan is used when abs(dx) or abs(dy) in the odometry frame exceeds `update_min_d`, or the turn
        exceeds `update_min_a` (``nav2_amcl/src/amcl_node.cpp``, ``shouldUpdateFilter``). ``"euclidean"``: the distance
        is hypot(dx, dy), as beluga has it (``beluga/policies/on_motion.hpp``).
    laser : array_like of int, shape (N,), optional
        Which laser took each scan; all the same by default. As in nav2, motion since the last used scan of any laser
        wakes all lasers, and each of them then contributes its next scan.

    Returns
    -------
    ndarray of int, shape (K,)
        Indices of used scans, increasing. The first scan of each laser is always used.

    Raises
    ------
    LogError
        When shapes disagree, a pose is not finite, a threshold is negative, or the rule is unknown.
    """
    where = "amcl_rows"
    table = table_of(where, "poses", poses, 3)
    distance = check_number("update_min_d", update_min_d, 0.0, unit="m", error=LogError, where=where)
    angle = check_number("update_min_a", update_min_a, 0.0, unit="rad", error=LogError, where=where)
    check_choice("rule", rule, UPDATE_RULES, error=LogError)
    lasers = np.zeros(len(table), dtype=np.int64)
    if laser is not None:
        lasers = numbers(where, "laser", laser).astype(np.int64)
        require_same_length(where, "laser", lasers, "poses", table)
    if distance == angle == 0.0:
        return np.arange(len(table), dtype=np.int64)
    awake = dict.fromkeys(lasers.tolist(), True)
    used: list[int] = []
    last = table[0]
    for k, (pose, number) in enumerate(zip(table, lasers.tolist(), strict=True)):
        dx, dy = abs(pose[0] - last[0]), abs(pose[1] - last[1])
        moved = max(dx, dy) if rule == "nav2" else np.hypot(dx, dy)
        if moved > distance or abs(float(wrap(pose[2] - last[2]))) > angle:
            awake = dict.fromkeys(awake, True)
        if awake[number]:
            used.append(k)
            awake[number] = False
            last = pose
    return np.array(used, dtype=np.int64)


def thinned(n_rays: int, max_beams: int | None) -> slice:
    """Choose rays that are evenly spread over a scan, by the rule of nav2's AMCL.

    nav2 takes every k-th ray from the first on, with k = (n - 1) / (max_beams - 1) rounded down and at least 1
    (``nav2_amcl/src/sensors/laser/``). Rounding down may leave somewhat more than `max_beams`.

    Parameters
    ----------
    n_rays : int
        Rays of a scan, n.
    max_beams : int or None
        How many to keep, at least 2; None keeps all.

    Returns
    -------
    slice
        ``scan[..., thinned(n, max_beams)]`` are the rays that stay.

    Raises
    ------
    LogError
        When `max_beams` is below 2.
    """
    if max_beams is None:
        return slice(None)
    most = check_whole("max_beams", max_beams, 2, error=LogError, advice="choose for example 60")
    if n_rays < 1:
        fail("thinned", f"expected a scan with rays, got {n_rays}: check the recording")
    return slice(0, None, max((n_rays - 1) // (most - 1), 1))
