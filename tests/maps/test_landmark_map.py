"""Landmark maps."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.errors import MapError
from pmcl.maps.landmarks import LandmarkMap


def test_names_default_to_indices():
    landmarks = LandmarkMap([[0.0, 1.0], [2.0, -3.0], [1.0, 0.0]])
    assert landmarks.names == ("0", "1", "2")
    assert landmarks.bounds == (0.0, 2.0, -3.0, 1.0)
    assert not landmarks.positions.flags.writeable


def test_names_become_text():
    assert LandmarkMap(np.zeros((2, 2)), [6, 17]).names == ("6", "17")


@pytest.mark.parametrize(
    ("positions", "names", "says"),
    [
        (np.empty((0, 2)), (), "at least one row"),
        (np.zeros((2, 3)), (), r"got shape \(2, 3\)"),
        ([[0.0, np.nan]], (), r"got nan at index \(0, 1\)"),
        ([["x", "y"]], (), "got text"),
        (np.zeros((2, 2)), ("a",), "expected 2 landmark names, got 1"),
        (np.zeros((3, 2)), ("a", "b", "a"), "'a' more than once"),
    ],
)
def test_bad_landmarks_are_one_line(positions, names, says):
    with pytest.raises(MapError, match=says) as caught:
        LandmarkMap(positions, names)
    assert "\n" not in str(caught.value)
