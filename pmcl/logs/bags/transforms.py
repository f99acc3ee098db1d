"""Transforms between the frames of a robot, as tf has them, and what they say in the plane."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import wrap
from pmcl.logs.validation import fail
from pmcl.maps.arrays import FARTHEST

__all__ = ["Edge", "Mount", "TransformTree", "yaw_of"]

Float = NDArray[np.float64]

# A mount may be published thousands of times with rounding, or through a joint that trembles: the tilting laser of a
# recorded robot by 1e-4 rad. A joint that is meant to move exceeds these bounds at once [m, rad].
_STILL_DISTANCE, _STILL_ANGLE = 0.005, 0.005
# The largest tilt of a laser that still counts as level [rad]. Beyond it the rays of a scan at 10 m differ in height by
# more than 1 m, and a planar map does not describe what they hit.
_LARGEST_TILT = 0.1
_NAMES_IN_MESSAGE = 12


class Mount(NamedTuple):
    """Where a laser sits on the robot, in the plane.

    Attributes
    ----------
    pose : ndarray, shape (3,)
        x, y and yaw of the laser's x axis on the robot [m, m, rad].
    upside_down : bool
        Whether its z axis points down, so that its angles run clockwise when seen from above.
    """

    pose: Float
    upside_down: bool


class Edge:
    """All transforms from one frame to another that a recording holds.

    While the transform has not changed, only its times are kept: 8 bytes for each message of a mount.

    Attributes
    ----------
    times : array of float
        Times of the messages [s].
    """

    def __init__(self) -> None:
        self.times = array("d")
        self._values = array("d")
        self._first: tuple[float, ...] = ()
        self._changed = False

    def add(self, time: float, value: tuple[float, ...]) -> None:
        """Add a transform: translation x, y, z [m] and quaternion x, y, z, w."""
        if not self.times:
            self._first = value
        elif not self._changed and value != self._first:
            self._changed = True
            self._values = array("d", self._first * len(self.times))
        self.times.append(time)
        if self._changed:
            self._values.extend(value)

    def values(self) -> Float:
        """Return the transforms, shape (N, 7): translation [m] and quaternion x, y, z, w."""
        if not self._changed:
            return np.tile(np.array(self._first), (len(self.times), 1))
        return np.frombuffer(self._values, dtype=np.float64).reshape(-1, 7).copy()

    @property
    def first(self) -> Float:
        """The first transform, shape (7,)."""
        return np.array(self._first)

    def is_still(self) -> bool:
        """Tell whether the transform never differs from its first one by more than rounding and trembling."""
        if not self._changed:
            return True
        values = self.values()
        moved = np.abs(values[:, :3] - values[0, :3]).max()
        # |q1 . q2| is the cosine of half the angle between two unit quaternions.
        cosine = np.abs(values[:, 3:] @ values[0, 3:]).min()
        return bool(moved <= _STILL_DISTANCE and 2.0 * math.acos(min(cosine, 1.0)) <= _STILL_ANGLE)

    def planar(self) -> Float:
        """Return the transforms in the plane, shape (N, 3): x, y, yaw [m, m, rad]."""
        values = self.values()
        return np.column_stack((values[:, :2], yaw_of(values[:, 3:])))


class TransformTree:
    """The transforms of a recording, by parent and child.

    Attributes
    ----------
    edges : dict of (str, str) to Edge
        From (parent, child) to what was recorded of it.
    n_invalid : int
        Transforms left out because a number in them is not finite or beyond :data:`~pmcl.maps.arrays.FARTHEST`, or
        their quaternion is not of length one.
    """

    def __init__(self) -> None:
        self.edges: dict[tuple[str, str], Edge] = {}
        self.n_invalid = 0

    def add(self, parent: str, child: str, time: float, value: tuple[float, ...]) -> None:
        """Add one transform from `parent` to `child`; see :meth:`Edge.add`."""
        length = math.hypot(*value[3:])
        # Single precision and text leave a quaternion within 1e-3 of length one; NaN fails the comparisons too.
        if not (abs(length - 1.0) < 1e-2 and all(abs(number) <= FARTHEST for number in value[:3])):
            self.n_invalid += 1
            return
        edge = self.edges.get((parent, child))
        if edge is None:
            edge = self.edges[parent, child] = Edge()
        edge.add(time, value)

    def frames(self) -> list[str]:
        """Return the names of all frames, sorted."""
        return sorted({name for pair in self.edges for name in pair})

    def ancestors(self, frame: str) -> list[str]:
        """Return a frame and all frames above it, from near to far."""
        line = [frame]
        for name in line:
            line += [parent for parent, child in self.edges if child == name and parent not in line]
        return line

    def mount(self, base: str, frame: str, where: str, what: str) -> Mount:
        """Find where a laser sits on the robot, along a chain of transforms that do not change.

        Parameters
        ----------
        base, frame : str
            Frame of the robot, and of the laser.
        where, what : str
            File, and name of the laser, for messages.

        Returns
        -------
        Mount

        Raises
        ------
        LogError
            When no chain of constant transforms leads from base to laser, or the laser is not level.
        """
        chain = self._chain(base, frame, only_still=True)
        if chain is None:
            if self._chain(base, frame, only_still=False) is not None:
                fail(
                    where,
                    f"expected a constant transform from '{base}' to '{frame}' of {what}, got one that moves: choose a "
                    "laser that is fixed to the robot",
                )
            fail(
                where,
                f"expected a transform from '{base}' to '{frame}' of {what} in /tf or /tf_static, got none "
                f"({_listed('frames', self.frames())}): record /tf_static, or correct the frame_id",
            )
        rotation, translation = np.eye(3), np.zeros(3)
        for pair, forward in chain:
            turn, shift = _matrix(self.edges[pair].first)
            if not forward:
                turn, shift = turn.T, -turn.T @ shift
            translation = translation + rotation @ shift
            rotation = rotation @ turn
        tilt = math.acos(min(abs(float(rotation[2, 2])), 1.0))
        if tilt > _LARGEST_TILT:
            fail(
                where,
                f"expected {what} to be level within {_LARGEST_TILT:g} rad, got a tilt of {tilt:.3g} rad from "
                f"'{base}' to '{frame}': choose a level laser",
            )
        yaw = math.atan2(rotation[1, 0], rotation[0, 0])
        return Mount(np.array([translation[0], translation[1], float(wrap(yaw))]), bool(rotation[2, 2] < 0.0))

    def _chain(self, base: str, frame: str, only_still: bool) -> list[tuple[tuple[str, str], bool]] | None:
        """Find transforms that lead from base to frame: (parent, child), and whether from parent to child."""
        reached: dict[str, list[tuple[tuple[str, str], bool]]] = {base: []}
        line = [base]
        usable = [pair for pair, edge in self.edges.items() if not only_still or edge.is_still()]
        for name in line:
            for parent, child in usable:
                for here, there, forward in ((parent, child, True), (child, parent, False)):
                    if here == name and there not in reached:
                        reached[there] = [*reached[name], ((parent, child), forward)]
                        line.append(there)
        return reached.get(frame)


def yaw_of(quaternions: Float) -> Float:
    """Return the yaw of rotations: the direction of the turned x axis in the plane.

    Parameters
    ----------
    quaternions : ndarray, shape (..., 4)
        x, y, z, w; of any positive length.

    Returns
    -------
    ndarray, shape (...)
        Yaw in [-pi, pi) [rad].
    """
    x, y, z, w = np.moveaxis(np.asarray(quaternions, dtype=np.float64), -1, 0)
    return wrap(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def _matrix(value: Float) -> tuple[Float, Float]:
    """Rotation matrix and translation of a transform."""
    x, y, z, w = value[3:] / np.linalg.norm(value[3:])
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, value[:3]


def _listed(what: str, names: Sequence[str]) -> str:
    if not names:
        return f"there are no {what}"
    more = f" and {len(names) - _NAMES_IN_MESSAGE} more" * (len(names) > _NAMES_IN_MESSAGE)
    return f"{what}: {', '.join(names[:_NAMES_IN_MESSAGE])}{more}"
