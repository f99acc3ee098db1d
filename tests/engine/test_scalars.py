"""Functions of single numbers, against NumPy and against the same functions for arrays."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pmcl.engine.scalars import HALF_LOG_2PI, LOG_2PI, TURN, log_sum, wrap_angle
from pmcl.geometry import wrap


def test_constants():
    assert 0.5 * np.log(2.0 * np.pi) == HALF_LOG_2PI
    assert (np.log(2.0 * np.pi), 2.0 * np.pi) == (LOG_2PI, TURN)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_are_those_of_arrays(angle):
    found = wrap_angle.py_func(angle)
    assert -math.pi - 1e-9 <= found <= math.pi + 1e-9
    # Where the turn begins, either end is right.
    assert abs(math.remainder(found - float(wrap(angle)), TURN)) < 1e-11
    if abs(angle) < 3.14159:
        assert found == angle


def test_a_compiled_angle_is_wrapped_too():
    angles = np.linspace(-20.0, 20.0, 1001)
    np.testing.assert_allclose([wrap_angle(angle) for angle in angles], wrap(angles), atol=1e-14)


@given(st.floats(-800.0, 800.0), st.floats(-800.0, 800.0))
def test_sums_on_the_scale_of_logarithms(a, b):
    assert math.isclose(log_sum.py_func(a, b), float(np.logaddexp(a, b)), rel_tol=1e-12, abs_tol=1e-12)
    assert log_sum.py_func(a, -math.inf) == a
    assert log_sum.py_func(-math.inf, -math.inf) == -math.inf
