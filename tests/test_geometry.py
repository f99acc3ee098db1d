"""SE(2): exact values, then properties that hold for any pose."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

from pmcl.errors import PmclError
from pmcl.geometry import between, circular_mean, compose, integrate_twist, inverse, wrap

coordinate = st.floats(-100.0, 100.0)
poses = arrays(np.float64, (3,), elements=coordinate)
angles = st.floats(-1e6, 1e6)


def same_pose(a, b, tolerance=1e-9):
    return np.allclose(a[..., :2], b[..., :2], atol=tolerance) and np.all(
        np.abs(wrap(a[..., 2] - b[..., 2])) < tolerance
    )


def as_matrix(pose):
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def test_compose_moves_in_the_frame_of_the_pose():
    facing_left = [1.0, 2.0, math.pi / 2]
    np.testing.assert_allclose(compose(facing_left, [3.0, 1.0, 0.5]), [0.0, 5.0, math.pi / 2 + 0.5], atol=1e-15)


def test_between_reads_the_move_off_two_poses():
    np.testing.assert_allclose(
        between([1.0, 2.0, math.pi / 2], [0.0, 5.0, math.pi]), [3.0, 1.0, math.pi / 2], atol=1e-15
    )


def test_shapes_broadcast():
    start = np.zeros((4, 1, 3))
    assert compose(start, np.zeros((5, 3))).shape == (4, 5, 3)
    assert between(np.zeros(3), np.zeros((7, 3))).shape == (7, 3)
    assert inverse(np.zeros((2, 6, 3))).shape == (2, 6, 3)
    assert integrate_twist(np.ones((4, 1)), np.ones(5), 0.1).shape == (4, 5, 3)


@pytest.mark.parametrize("call", [compose, between, lambda a, b: inverse(b)])
@pytest.mark.parametrize("wrong", [[1.0, 2.0], 5.0, np.zeros((3, 4))])
def test_wrong_last_axis_is_one_line(call, wrong):
    with pytest.raises(PmclError, match="last axis of length 3") as caught:
        call(np.zeros(3), wrong)
    assert "\n" not in str(caught.value)


@given(poses, poses, poses)
def test_composition_is_the_product_of_matrices(a, b, c):
    np.testing.assert_allclose(as_matrix(compose(a, b)), as_matrix(a) @ as_matrix(b), atol=1e-10)
    assert same_pose(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(poses, poses)
def test_between_inverts_compose(a, b):
    assert same_pose(compose(a, between(a, b)), b)
    assert same_pose(between(a, compose(a, b)), b)


@given(poses)
def test_inverse_undoes_from_both_sides(a):
    assert same_pose(compose(a, inverse(a)), np.zeros(3))
    assert same_pose(compose(inverse(a), a), np.zeros(3))


@given(angles)
def test_wrap_stays_in_the_half_open_interval_and_keeps_the_direction(angle):
    wrapped = wrap(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
    assert wrap(wrapped) == wrapped


@pytest.mark.parametrize(
    ("angle", "expected"),
    [
        (math.pi, -math.pi),
        (-math.pi, -math.pi),
        (np.nextafter(math.pi, 0.0), np.nextafter(math.pi, 0.0)),
        (0.0, 0.0),
        (1e-300, 1e-300),
        (-1e-300, -1e-300),
        (3.0 * math.pi, -math.pi),
        (2.0, 2.0),
    ],
)
def test_wrap_at_the_edges(angle, expected):
    assert wrap(angle) == expected


def test_wrap_just_outside_the_interval():
    assert wrap(np.nextafter(-math.pi, -4.0)) in (-math.pi, np.nextafter(math.pi, 0.0))
    assert -math.pi <= wrap(np.nextafter(math.pi, 4.0)) < -3.14159


def test_wrap_keeps_nan_and_has_no_answer_for_infinity():
    assert np.isnan(wrap([np.nan, np.inf, -np.inf])).all()


def test_circular_mean_crosses_the_seam():
    mean = circular_mean([math.pi - 0.1, -math.pi + 0.3])
    assert abs(wrap(mean - (-math.pi + 0.1))) < 1e-12
    assert circular_mean([[0.0, 1.0], [2.0, 2.0]], [[3.0, 0.0], [1.0, 1.0]]) == pytest.approx([0.0, 2.0])


@given(arrays(np.float64, (6,), elements=st.floats(-1.0, 1.0)), coordinate)
def test_circular_mean_turns_with_its_angles(around_zero, turn):
    shift = circular_mean(around_zero + turn) - circular_mean(around_zero)
    assert abs(wrap(shift - turn)) < 1e-9


def test_integrate_twist_on_a_quarter_circle():
    np.testing.assert_allclose(integrate_twist(math.pi, math.pi / 2, 1.0), [2.0, 2.0, math.pi / 2], rtol=1e-15)
    np.testing.assert_array_equal(integrate_twist(0.7, 0.0, 2.0), [1.4, 0.0, 0.0])


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(1e-3, 2.0))
def test_integrate_twist_is_the_matrix_exponential(v, w, dt):
    generator = np.array([[0.0, -w, v], [w, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(as_matrix(integrate_twist(v, w, dt)), expm(generator * dt), atol=1e-12)


@pytest.mark.parametrize("w", [1e-300, 1e-16, 1e-9, 1e-5, 1e-3, -1e-7])
def test_integrate_twist_keeps_its_digits_for_slow_turns(w):
    forward, left, turn = integrate_twist(2.0, w, 1.0)
    assert forward == pytest.approx(2.0 * (1.0 - w**2 / 6.0), rel=1e-13)
    assert left == pytest.approx(w * (1.0 - w**2 / 12.0), rel=1e-13)
    assert turn == w


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_integrate_twist_adds_up_over_time(v, w, first, second):
    assert same_pose(
        compose(integrate_twist(v, w, first), integrate_twist(v, w, second)), integrate_twist(v, w, first + second)
    )
