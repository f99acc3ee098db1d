"""The scratch rows of the full kernels of landmark sightings. Column i of each row belongs to state i."""

from __future__ import annotations

__all__ = [
    "AHEAD", "ANGLE", "ASIDE", "BEFORE", "BELOW", "COSINE", "DISTANCE", "DRAFT", "OTHERS", "POSE", "POSE_BEFORE",
    "POSE_NOW", "ROWS", "SHARE", "SINE", "TARGET", "WEIGHT",
]  # fmt: skip

# Three rows: the pose of the sensor when each column was read; then sine and cosine of the direction it looks in.
POSE, SINE, COSINE = 0, 3, 4
# Where a landmark lies: ahead of the sensor and aside, its distance and its bearing.
AHEAD, ASIDE, DISTANCE, ANGLE = 5, 6, 7, 8
# The log density that is being computed, that of another component of the mixture, and work space.
TARGET, OTHERS, DRAFT = 9, 10, 11
# From here on, the rows POSE to ANGLE again, of the states one row earlier.
BEFORE = 12
# Along a path, of the state of each sighting and the one before: three rows each. Then a share of a mixture.
POSE_BEFORE, POSE_NOW, WEIGHT = 21, 24, 27
# In their place, of single readings: the probability of a component of the mixture with the readings before, and that
# of a smaller reading.
SHARE, BELOW = 21, 22
ROWS = 28
