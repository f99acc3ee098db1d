"""Vector kernels against NumPy, over the whole range that their docstrings promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from pmcl.engine.vector_math import (
    atan2_into,
    exp_into,
    extremes,
    log_into,
    maximum,
    sincos_into,
    total,
    upper_tail_into,
)

EPS = np.finfo(float).eps
SMALLEST_NORMAL = np.finfo(float).tiny


def _exp(x, shift=0.0):
    x = np.asarray(x, dtype=float)
    out = np.empty_like(x)
    exp_into(x, shift, out)
    return out


def _log(x):
    x = np.asarray(x, dtype=float)
    out = np.empty_like(x)
    log_into(x, out)
    return out


def _sincos(angle):
    angle = np.asarray(angle, dtype=float)
    sine, cosine = np.empty_like(angle), np.empty_like(angle)
    sincos_into(angle, sine, cosine)
    return sine, cosine


def _upper_tail(x):
    x = np.asarray(x, dtype=float)
    out = np.empty_like(x)
    upper_tail_into(x, out)
    return out


def _atan2(y, x):
    y, x = np.broadcast_arrays(np.asarray(y, dtype=float), np.asarray(x, dtype=float))
    out = np.empty(y.shape)
    atan2_into(y.copy(), x.copy(), out)
    return out


def test_exp_agrees_with_numpy(rng):
    x = np.concatenate([rng.uniform(-699.9, 700.0, 20_001), rng.normal(size=2_000) * 1e-8, [0.0, -0.0, 1.0, -1.0]])
    np.testing.assert_allclose(_exp(x), np.exp(x), rtol=4 * EPS)
    assert _exp([0.0])[0] == 1.0


def test_exp_near_every_rounding_boundary():
    # Multiples of ln 2 / 2 are where the reduced argument jumps.
    k = np.arange(-1900, 1900) * 0.5 * np.log(2.0)
    x = np.concatenate([k, np.nextafter(k, 1e9), np.nextafter(k, -1e9)])
    x = x[(x > -700.0) & (x < 700.0)]
    np.testing.assert_allclose(_exp(x), np.exp(x), rtol=4 * EPS)


def test_exp_is_exactly_zero_far_down():
    x = np.array([-700.1, -745.0, -1e6, -1e300, -np.inf])
    np.testing.assert_array_equal(_exp(x), np.zeros(5))


def test_exp_of_no_number_is_no_number():
    assert np.isnan(_exp([np.nan, 1.0, np.nan])[[0, 2]]).all()


def test_exp_shifts_before_it_tests_for_underflow():
    np.testing.assert_allclose(_exp([-1e6, -1e6 - 1.0], -1e6), [1.0, np.exp(-1.0)], rtol=4 * EPS)
    np.testing.assert_array_equal(_exp([0.0, -np.inf], 701.0), [0.0, 0.0])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 8, 9, 31])
def test_no_element_is_left_out_at_any_length(n, rng):
    # Vector loops have a remainder; each length exercises another one.
    x = rng.uniform(0.1, 3.0, n)
    np.testing.assert_allclose(_exp(x), np.exp(x), rtol=4 * EPS)
    np.testing.assert_allclose(_log(x), np.log(x), rtol=4 * EPS, atol=EPS)
    np.testing.assert_allclose(_sincos(x), (np.sin(x), np.cos(x)), atol=2 * EPS)
    np.testing.assert_allclose(_atan2(x, 1.0), np.arctan(x), rtol=4 * EPS)
    assert total(x) == pytest.approx(x.sum(), rel=n * EPS)
    assert maximum(x) == x.max()
    assert extremes(x) == (x.min(), x.max())


def test_log_agrees_with_numpy_over_all_normal_numbers(rng):
    everywhere, near_one = np.exp(rng.uniform(-708.0, 709.0, 20_001)), 1.0 + rng.normal(size=2_000) * 1e-6
    x = np.concatenate([everywhere, near_one, [SMALLEST_NORMAL, 1.0, 2.0, 1e308]])
    np.testing.assert_allclose(_log(x), np.log(x), rtol=4 * EPS, atol=EPS)
    assert _log([1.0])[0] == 0.0


def test_log_of_what_is_no_normal_number():
    x = np.array([0.0, -0.0, 5e-324, 1e-310, np.nextafter(SMALLEST_NORMAL, 0.0), np.inf])
    np.testing.assert_array_equal(_log(x), [-np.inf, -np.inf, -np.inf, -np.inf, -np.inf, np.inf])
    assert np.isnan(_log([-1.0, -5e-324, -np.inf, np.nan])).all()


def test_log_does_not_change_its_argument():
    x = np.array([0.5, 3.0, 1e-320])
    kept = x.copy()
    _log(x)
    np.testing.assert_array_equal(x, kept)


def test_sincos_agrees_with_numpy(rng):
    angle = np.concatenate([rng.uniform(-10.0, 10.0, 20_001), rng.uniform(-1e5, 1e5, 20_001), [0.0, -0.0]])
    sine, cosine = _sincos(angle)
    np.testing.assert_allclose(sine, np.sin(angle), atol=4 * EPS)
    np.testing.assert_allclose(cosine, np.cos(angle), atol=4 * EPS)


def test_sincos_in_every_quadrant_and_on_its_borders():
    border = np.arange(-64, 65) * 0.25 * np.pi
    angle = np.concatenate([border, np.nextafter(border, 1e9), np.nextafter(border, -1e9)])
    sine, cosine = _sincos(angle)
    np.testing.assert_allclose(sine, np.sin(angle), atol=2 * EPS)
    np.testing.assert_allclose(cosine, np.cos(angle), atol=2 * EPS)
    np.testing.assert_allclose(sine**2 + cosine**2, 1.0, rtol=4 * EPS)


def test_sincos_of_no_number_is_no_number():
    sine, cosine = _sincos([np.nan, np.inf, -np.inf])
    assert np.isnan(sine).all()
    assert np.isnan(cosine).all()


def test_atan2_agrees_with_numpy(rng):
    y, x = rng.normal(size=(2, 20_001)) * np.exp(rng.uniform(-20.0, 20.0, (2, 20_001)))
    np.testing.assert_allclose(_atan2(y, x), np.arctan2(y, x), rtol=4 * EPS, atol=4 * EPS)


def test_atan2_on_axes_diagonals_and_switch_points():
    angle = np.concatenate([np.arange(-16, 17) * np.pi / 16.0, np.arange(-8, 8) * np.pi / 8.0 + 1e-12])
    y, x = np.sin(angle), np.cos(angle)
    np.testing.assert_allclose(_atan2(y, x), np.arctan2(y, x), atol=8 * EPS)
    np.testing.assert_allclose(
        _atan2([0.0, 0.0, 1.0, -1.0, 1.0], [1.0, -1.0, 0.0, 0.0, 1.0]),
        [0.0, np.pi, np.pi / 2, -np.pi / 2, np.pi / 4],
        atol=4 * EPS,
    )


def test_atan2_of_the_zero_vector_is_zero():
    np.testing.assert_array_equal(_atan2([0.0, -0.0], [0.0, 0.0]), [0.0, 0.0])


def test_atan2_of_no_number_is_no_number():
    # A NaN that came out as an angle would turn a broken pose into a likelihood.
    assert np.isnan(_atan2([np.nan, 1.0, np.nan], [1.0, np.nan, np.nan])).all()


def test_upper_tail_agrees_with_scipy_wherever_it_is_a_normal_number():
    x = np.concatenate([np.linspace(-40.0, 37.0, 77_001), [0.0, -0.0, 1e-300, -1e-17]])
    np.testing.assert_allclose(_upper_tail(x), special.ndtr(-x), rtol=2e-13, atol=0.0)
    near = np.abs(x) < 6.0
    np.testing.assert_allclose(_upper_tail(x[near]), special.ndtr(-x[near]), rtol=2e-14, atol=0.0)


def test_upper_tail_of_infinity_and_of_no_number():
    np.testing.assert_array_equal(_upper_tail([np.inf, -np.inf, 60.0, -60.0, np.nan]), [0.0, 1.0, 0.0, 1.0, np.nan])


def test_total_keeps_nan_and_infinity():
    assert np.isnan(total(np.array([1.0, np.nan, 2.0])))
    assert np.isnan(total(np.array([1.0] * 37 + [np.nan])))
    assert total(np.array([0.0, -np.inf, -1.0, -np.inf])) == -np.inf
    assert total(np.empty(0)) == 0.0


def test_maximum_of_infinities():
    assert maximum(np.array([-np.inf, -np.inf])) == -np.inf
    assert maximum(np.array([-np.inf, -3.0, -1e300])) == -3.0
    assert maximum(np.array([-1.0] * 40 + [-0.5])) == -0.5


def test_maximum_of_no_number_is_no_number():
    """A density that is no number must not hide among the others."""
    for x in ([1.0, np.nan, np.inf], [np.nan], [-np.inf, np.nan]):
        assert np.isnan(maximum(np.array(x)))


def test_extremes_of_zeros_and_infinities():
    assert extremes(np.array([0.0, -0.0, 5e-324])) == (0.0, 5e-324)
    assert extremes(np.array([-np.inf, 2.0, np.inf])) == (-np.inf, np.inf)
    assert extremes(np.array([-2.0, -1e-300, -3.0])) == (-3.0, -1e-300)
