"""The scratch rows of the full kernels, after those of casting and of the walls.

They begin at :func:`first_row`. Column i of each row belongs to state i.
"""

from __future__ import annotations

from pmcl.engine.compile import kernel
from pmcl.models.sensors.range_beams.kernels.casting import CASTING_ROWS

__all__ = [
    "BEAM_ROWS", "CENTRE", "DRAFT", "ECHO", "EXPECTED", "OTHERS", "OTHER_RAY", "OWN_SHARE", "POSE", "POSE_BEFORE",
    "READING", "STD", "VALUES", "WIDTH", "first_row", "row_count",
]  # fmt: skip

# Three rows: the pose at which the beams of each column were read.
POSE = 0
# 1 / length of one more ray of a beam's cone; free while nothing is cast.
OTHER_RAY = 3
# The reading of one beam, what its own echo should read there, and the standard deviation of that.
READING, EXPECTED, STD = 4, 5, 6
# Centre and width of its own echo, given the echo before.
CENTRE, WIDTH = 7, 8
# The log density of its own echo, the probability that the reading is that echo, and the density of all else.
ECHO, OWN_SHARE, OTHERS = 9, 10, 11
# Work space.
DRAFT, VALUES = 12, 13
# Three rows: the poses one row earlier, along a path.
POSE_BEFORE = 14
# After these come, with one row for each beam: 1 / length of its ray, the cosine of incidence of its middle ray, and
# 1 / length of its ray in the row before.
BEAM_ROWS = 17


@kernel
def first_row(sensor):
    """Return the first of the rows named here."""
    return CASTING_ROWS + sensor.wall_start.size


@kernel
def row_count(sensor):
    """Return how many rows there are in all, those of casting included."""
    return first_row(sensor) + BEAM_ROWS + 3 * sensor.reading.shape[1]
