"""Segment maps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from shapely.geometry import Point, Polygon

from pmcl.errors import MapError
from pmcl.maps.walls import WallMap

L_SHAPE = [[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]]


def test_polygon_becomes_its_outline():
    room = WallMap.from_polygon(L_SHAPE)
    assert room.segments.shape == (6, 2, 2)
    np.testing.assert_array_equal(room.segments[5], [[0.0, 3.0], [0.0, 0.0]])
    assert room.bounds == (0.0, 4.0, 0.0, 3.0)
    assert room.is_closed


def test_contains_keeps_the_shape_of_the_points():
    room = WallMap.from_polygon(L_SHAPE)
    points = np.array([[[3.0, 0.5], [3.0, 2.0]], [[0.5, 2.0], [-1.0, 0.5]], [[5.0, 0.5], [np.nan, 0.5]]])
    np.testing.assert_array_equal(room.contains(points), [[True, False], [True, False], [False, False]])
    assert room.contains([0.5, 0.5, 99.0]).shape == ()
    assert bool(room.contains([0.5, 0.5, 99.0]))


def test_contains_level_with_corners():
    diamond = WallMap.from_polygon([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    np.testing.assert_array_equal(diamond.contains([[-2.0, 0.0], [-0.5, 0.0], [2.0, 0.0], [-1.0, 1.0]]), [0, 1, 0, 0])


def test_contains_agrees_with_an_independent_library(rng):
    for _ in range(20):
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
        corners = rng.uniform(0.5, 3.0, (9, 1)) * np.column_stack((np.cos(angle), np.sin(angle)))
        points = rng.uniform(-3.0, 3.0, (200, 2))
        oracle = Polygon(corners)
        expected = [oracle.contains(Point(p)) for p in points]
        assert oracle.is_valid
        np.testing.assert_array_equal(WallMap.from_polygon(corners).contains(points), expected)


def test_an_obstacle_in_a_room_is_outside():
    room, pillar = (
        WallMap.from_polygon([[0, 0], [4, 0], [4, 4], [0, 4]]),
        WallMap.from_polygon([[1, 1], [2, 1], [2, 2], [1, 2]]),
    )
    both = WallMap(np.concatenate((room.segments, pillar.segments)))
    assert both.is_closed
    np.testing.assert_array_equal(both.contains([[0.5, 0.5], [1.5, 1.5], [3.0, 3.0]]), [True, False, True])


@pytest.mark.parametrize("change", ["drop a wall", "add a partition"])
def test_an_open_map_is_not_closed(change):
    walls = WallMap.from_polygon(L_SHAPE).segments
    walls = walls[1:] if change == "drop a wall" else np.concatenate((walls, [[[0.0, 0.0], [0.5, 0.5]]]))
    assert not WallMap(walls).is_closed


def test_vertices_and_edges_rebuild_the_walls(rng):
    room = WallMap.from_polygon(L_SHAPE)
    shuffled = WallMap(room.segments[rng.permutation(6)])
    vertices, start, stop = shuffled.vertices_and_edges()
    assert vertices.shape == (6, 2)
    assert start.dtype == stop.dtype == np.int64
    np.testing.assert_array_equal(np.stack((vertices[start], vertices[stop]), axis=1), shuffled.segments)


def test_corners_are_shared_in_spite_of_rounding():
    a, b, c = [0.1 + 0.2, -0.0], [1.0, 0.0], [0.0, 1.0]
    vertices, _, _ = WallMap([[a, b], [b, c], [c, [0.3, 0.0]]]).vertices_and_edges()
    assert len(vertices) == 3


def test_walls_are_a_private_read_only_copy():
    mine = np.array(WallMap.from_polygon(L_SHAPE).segments)
    room = WallMap(mine)
    mine[0, 0, 0] = 99.0
    assert room.segments[0, 0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        room.segments[0, 0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        room.segments = mine


@pytest.mark.parametrize(
    ("walls", "says"),
    [
        (np.empty((0, 2, 2)), "at least one row"),
        ([], "at least one row"),
        (np.zeros((3, 4)), r"got shape \(3, 4\)"),
        (5.0, r"got shape \(\)"),
        ([[[0, 0], [1, 0]], [[2, 2], [2, 2]]], r"\(2, 2\) m in wall 1"),
        ([[[0, 0], [1, np.nan]]], r"got nan at index \(0, 1, 1\)"),
        ([[[0, 0], [np.inf, 1]]], r"got inf at index \(0, 1, 0\)"),
        ([[["a", "b"], ["c", "d"]]], "got text such as 'a'"),
        ([[["1", "2"], ["3", "4"]]], "got text such as '1'"),
        ([[[0, 0], [1]]], "unequal length"),
    ],
)
def test_bad_walls_are_one_line(walls, says):
    with pytest.raises(MapError, match=says) as caught:
        WallMap(walls)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("corners", "says"), [([[0, 0], [1, 1]], "at least 3 corners, got 2"), ([[0, 0, 0]] * 3, "shape")]
)
def test_bad_polygons_are_one_line(corners, says):
    with pytest.raises(MapError, match=says) as caught:
        WallMap.from_polygon(corners)
    assert "\n" not in str(caught.value)


def test_contains_wants_two_coordinates():
    with pytest.raises(MapError, match=r"got \(4, 1\)"):
        WallMap.from_polygon(L_SHAPE).contains(np.zeros((4, 1)))
