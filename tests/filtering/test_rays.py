"""Ray casting against an independent geometry library, and at the corners where ray casters leak."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from pmcl.maps.walls import WallMap
from pmcl.models.sensors.range_beams.kernels.rays import cast_rays

FAR = 1e3


def _cast(walls, poses):
    return cast_rays(*walls.vertices_and_edges(), np.asarray(poses, dtype=float))


def _shapely_lengths(segments, poses):
    """Distance to the nearest wall along each ray, by intersecting long lines with every wall."""
    poses = np.asarray(poses, dtype=float)
    walls = shapely.linestrings(segments)
    tips = poses[:, :2] + FAR * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
    rays = shapely.linestrings(np.stack([poses[:, :2], tips], axis=1))
    origins = shapely.points(poses[:, :2])
    met = shapely.intersection(rays[:, None], walls[None, :])
    return np.nanmin(np.where(shapely.is_empty(met), np.inf, shapely.distance(met, origins[:, None])), axis=1)


def _star(rng, corners):
    """A closed outline around the origin, star-shaped with random radii."""
    angle = (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) * 2.0 * np.pi / corners
    radius = rng.uniform(1.5, 5.0, corners)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _with_free_walls(room, rng, count):
    a = rng.uniform(-4.0, 4.0, (count, 2))
    b = a + rng.normal(0.0, 1.0, (count, 2))
    return WallMap(np.concatenate([room.segments, np.stack([a, b], axis=1)]))


def _poses(rng, count, reach):
    return np.column_stack([rng.uniform(-reach, reach, (count, 2)), rng.uniform(-10.0, 10.0, count)])


@pytest.mark.parametrize(("corners", "free"), [(3, 0), (4, 1), (7, 2), (12, 5)])
def test_random_rays_agree_with_shapely(corners, free, rng):
    """Odd and even numbers of vertices and walls, inside and outside the room."""
    walls = WallMap.from_polygon(_star(rng, corners))
    if free:
        walls = _with_free_walls(walls, rng, free)
    poses = _poses(rng, 400, 6.0)
    expected = _shapely_lengths(walls.segments, poses)
    assert np.isinf(expected).any()
    assert np.isfinite(expected).sum() > 50
    np.testing.assert_allclose(_cast(walls, poses), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize("width", [0.0, 1e-6, 0.01, 0.3, 3.0])
def test_walls_that_no_ray_of_a_bundle_can_meet_are_left_out_without_a_trace(width, offset, rng):
    """Bundles as narrow and as wide as a filter's particles; each ray must find what it finds in any other company."""
    walls = _with_free_walls(WallMap.from_polygon(_star(rng, 9)), rng, 4)
    shift = np.array([offset, -offset, 0.0])
    moved = WallMap(walls.segments + shift[:2])
    company = np.array([[40.0, 40.0, 0.0], [-40.0, -40.0, 2.0], [40.0, -40.0, 4.0]])
    for centre in _poses(rng, 30, 4.0):
        bundle = centre + width * rng.uniform(-1.0, 1.0, (40, 3))
        among_others = _cast(walls, np.concatenate([bundle, company]))[:40]
        np.testing.assert_allclose(among_others, _shapely_lengths(walls.segments, bundle), rtol=1e-9, atol=1e-9)
        alone = _cast(moved, bundle + shift)
        np.testing.assert_allclose(alone, among_others, rtol=1e-9, atol=1e-9 + 1e-9 * offset)
        # So few rays try all walls.
        np.testing.assert_array_equal(_cast(moved, bundle[:9] + shift), alone[:9])


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(
    segments=st.lists(
        st.tuples(*[st.floats(-5.0, 5.0).map(lambda v: round(v, 3))] * 4).filter(
            lambda s: np.hypot(s[2] - s[0], s[3] - s[1]) > 0.05
        ),
        min_size=1,
        max_size=6,
    ),
    pose=st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-7.0, 7.0)),
)
def test_any_walls_agree_with_shapely(segments, pose):
    walls = WallMap(np.array(segments).reshape(-1, 2, 2))
    # A ray through the very end of a wall may hit or miss it in either library: only rays that keep clear are compared.
    direction = np.array([np.cos(pose[2]), np.sin(pose[2])])
    delta = walls.segments.reshape(-1, 2) - np.array(pose[:2])
    aside = np.abs(delta[:, 0] * direction[1] - delta[:, 1] * direction[0])
    clearance = shapely.distance(shapely.points(pose[:2]), shapely.linestrings(walls.segments))
    assume(aside.min() > 1e-6 and clearance.min() > 1e-6)
    expected = _shapely_lengths(walls.segments, [pose])
    np.testing.assert_allclose(_cast(walls, [pose]), expected, rtol=1e-7, atol=1e-7)


def test_no_ray_slips_through_the_corners_of_a_room(rng):
    """Rays aimed exactly at each corner, from many places inside, all end at a wall."""
    for _ in range(20):
        corners = _star(rng, int(rng.integers(5, 11)))
        walls = WallMap.from_polygon(corners)
        origins = rng.uniform(-0.3, 0.3, (50, 2))
        origins = origins[walls.contains(origins)]
        delta = corners[None] - origins[:, None]
        heading = np.arctan2(delta[..., 1], delta[..., 0])
        poses = np.concatenate([np.broadcast_to(origins[:, None], delta.shape), heading[..., None]], axis=-1)
        lengths = _cast(walls, poses)
        distance = np.hypot(delta[..., 0], delta[..., 1])
        assert lengths.shape == distance.shape
        assert (lengths <= distance * (1.0 + 1e-9)).all()
        # A star-shaped room hides no corner from its centre, and places near it see nearly every one.
        assert np.median(np.abs(lengths - distance)) < 1e-9


def test_exact_corner_hits_in_a_square():
    square = WallMap.from_polygon([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    poses = [[0.0, 0.0, k * np.pi / 4.0] for k in range(8)]
    expected = np.where(np.arange(8) % 2, np.sqrt(2.0), 1.0)
    np.testing.assert_allclose(_cast(square, poses), expected, rtol=1e-12)


def test_a_wall_seen_edge_on_is_hit_only_where_another_meets_its_end():
    edge_on = np.array([[[1.0, 0.0], [2.0, 0.0]]])
    poses = [[0.0, 0.0, 0.0]]
    assert np.isinf(_cast(WallMap(edge_on), poses)[0])
    crossing = np.array([[[1.0, 0.0], [1.0, 1.0]]])
    assert _cast(WallMap(np.concatenate([edge_on, crossing])), poses)[0] == pytest.approx(1.0)


def test_rays_along_the_walls_of_a_room_end_at_its_corners():
    square = WallMap.from_polygon([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    # From on the lower wall, along it, the ray ends where the next wall stands.
    assert _cast(square, [[1.0, 0.0, 0.0]])[0] == pytest.approx(3.0)
    assert _cast(square, [[4.0, 1.0, np.pi / 2.0]])[0] == pytest.approx(2.0)


def test_a_ray_from_a_wall_sees_the_opposite_one_or_the_wall_itself():
    square = WallMap.from_polygon([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
    length = _cast(square, [[2.0, 0.0, np.pi / 2.0]])[0]
    assert length in (0.0, pytest.approx(3.0))
    assert np.isinf(_cast(square, [[2.0, -1e-9, -np.pi / 2.0]])[0])


def test_rays_from_outside_meet_the_near_side_and_rays_away_meet_nothing():
    square = WallMap.from_polygon([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    lengths = _cast(square, [[3.0, 0.2, np.pi], [3.0, 0.2, 0.0], [0.3, -5.0, np.pi / 2.0]])
    np.testing.assert_allclose(lengths, [2.0, np.inf, 4.0], rtol=1e-12)


def test_no_wall_behind_the_origin_is_hit():
    wall = WallMap(np.array([[[1.0, -1.0], [1.0, 1.0]]]))
    assert np.isinf(_cast(wall, [[2.0, 0.0, 0.0]])[0])
    assert _cast(wall, [[2.0, 0.0, np.pi]])[0] == pytest.approx(1.0)


def test_lengths_do_not_depend_on_the_order_of_walls_or_ends(rng):
    walls = _with_free_walls(WallMap.from_polygon(_star(rng, 6)), rng, 3)
    poses = _poses(rng, 200, 4.0)
    flipped = WallMap(walls.segments[::-1, ::-1])
    np.testing.assert_allclose(_cast(flipped, poses), _cast(walls, poses), rtol=1e-12)


def test_shape_of_the_poses_is_kept(rng):
    walls = WallMap.from_polygon(_star(rng, 5))
    poses = _poses(rng, 24, 1.0)
    flat = _cast(walls, poses)
    np.testing.assert_array_equal(_cast(walls, poses.reshape(2, 3, 4, 3)), flat.reshape(2, 3, 4))
    assert _cast(walls, poses[0]).shape == ()
    assert _cast(walls, np.empty((0, 3))).shape == (0,)
