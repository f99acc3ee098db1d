"""Parameters on the whole real line."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.models.parameters import Parameter
from pmcl.sampling.transforms import Unconstrained

# mypy: disable-error-code="no-untyped-def"

LINE = Unconstrained([
    Parameter("bias", "m", stats.norm(0.0, 1.0)),
    Parameter("noise", "m", stats.expon(0.1, 2.0)),
    Parameter("share", "1", stats.uniform(-1.0, 3.0)),
])


@pytest.fixture
def thetas():
    rng = np.random.default_rng(1)
    return np.column_stack([rng.normal(size=50), 0.1 + rng.exponential(size=50), rng.uniform(-1.0, 2.0, 50)])


def test_values_go_there_and_back(thetas):
    for theta in thetas:
        np.testing.assert_allclose(LINE.from_line(LINE.to_line(theta))[0], theta, rtol=1e-12)


def test_one_value_goes_where_many_go(thetas):
    np.testing.assert_allclose([LINE.to_line(theta) for theta in thetas], LINE.to_line(thetas), rtol=1e-13)


@pytest.mark.filterwarnings("ignore:divide by zero|invalid value")
@pytest.mark.parametrize("theta", [[0.0, 0.1, 0.5], [0.0, 0.0, 0.5], [0.0, 1.0, 2.0], [0.0, 1.0, -1.5]])
def test_limits_and_what_lies_beyond_them_have_the_same_values(theta):
    theta = np.array(theta)
    np.testing.assert_array_equal(LINE.to_line(theta), LINE.to_line(theta[None])[0])


def test_jacobian_against_finite_differences(thetas):
    step = 1e-6
    for theta in thetas[:10]:
        u = LINE.to_line(theta)
        slopes = [
            (LINE.from_line(u + step * one)[0] - LINE.from_line(u - step * one)[0])[k] / (2.0 * step)
            for k, one in enumerate(np.eye(3))
        ]
        np.testing.assert_allclose(LINE.from_line(u)[1], np.log(slopes).sum(), atol=1e-6)
