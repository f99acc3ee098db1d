"""Normal, exponential and Student deviates drawn many at a time: distribution, tails included, and independence."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pmcl.engine import random_numbers
from pmcl.engine.compile import entry
from pmcl.engine.random_numbers import exponentials_into, normals_into, students_into

pytestmark = pytest.mark.slow  # compiling kernels that no other test needs takes most of the time

# mypy: disable-error-code="no-untyped-def"

MANY = 4_000_000
TAILS = {"normal": (3.0, stats.norm, 3.6541528853610088), "exponential": (6.0, stats.expon, 7.69711747013104972)}


@entry
def draw_normals(rng, out):
    normals_into(rng, out, np.empty(out.shape[1]))


@entry
def draw_exponentials(rng, out):
    outside = np.empty(out.shape[1])
    for d in range(out.shape[0]):
        exponentials_into(rng, out[d], outside)


@entry
def draw_students(rng, out, a):
    students_into(rng, out, a, np.empty((3, out.shape[1])))


def draw(kind, rng, shape):
    out = np.full(shape, np.nan)
    (draw_normals if kind == "normal" else draw_exponentials)(rng, out)
    return out


@pytest.mark.parametrize("kind", TAILS)
def test_the_distribution_is_that_of_its_name(kind, rng):
    """Four million draws: a shift by four thousandths would be seen."""
    values = draw(kind, rng, (4, MANY // 4)).ravel()
    family = TAILS[kind][1]
    assert stats.kstest(values, family.cdf).pvalue > 1e-4
    assert stats.kstest(values + 4e-3, family.cdf).pvalue < 1e-4


@pytest.mark.parametrize("kind", TAILS)
def test_the_tail_is_right_on_both_sides_of_where_it_is_drawn_otherwise(kind, rng):
    low, family, seam = TAILS[kind]
    values = np.abs(draw(kind, rng, (4, MANY // 4)).ravel())
    tail = values[values > low]
    assert tail.size > 5_000
    assert stats.kstest(tail, lambda x: 1.0 - family.sf(x) / family.sf(low)).pvalue > 1e-4
    beyond = values[values > seam]
    both = 2.0 if kind == "normal" else 1.0
    assert stats.binomtest(beyond.size, MANY, both * family.sf(seam)).pvalue > 1e-4
    assert stats.kstest(beyond, lambda x: 1.0 - family.sf(x) / family.sf(seam)).pvalue > 1e-4


@pytest.mark.parametrize("a", [0.5, 0.25, 0.01, 1e-7, 1e-9, 1e-14])
def test_students_have_their_degrees_of_freedom(a, rng):
    """Also in the tails, and on both sides of where the formula changes; a neighbour of the law is told from it."""
    out = np.empty((3, MANY // 3))
    draw_students(rng, out, a)
    values, law = out.ravel(), stats.t(1.0 / a) if a > 1e-6 else stats.norm
    assert stats.kstest(values, law.cdf).pvalue > 1e-4
    far = np.abs(values[np.abs(values) > 3.0])
    assert stats.kstest(far, lambda x: 1.0 - law.sf(x) / law.sf(3.0)).pvalue > 1e-4
    assert stats.kstest(values, stats.t(1.0 / (a + 0.01)).cdf).pvalue < 1e-4
    columns = out[:, : MANY // 6]
    assert np.abs(np.corrcoef(np.abs(columns))[np.triu_indices(3, 1)]).max() < 6.0 / np.sqrt(columns.shape[1])


@pytest.mark.parametrize("kind", ["normal", "exponential"])
def test_every_layer_is_closed(kind):
    """The last of the 256 rectangles of one area must reach the top of the density."""
    width = getattr(random_numbers, f"_{kind.upper()}_WIDTH") * 2.0**55
    density = getattr(random_numbers, f"_{kind.upper()}_DENSITY")
    area = width[1:] * np.diff(density[1:])
    np.testing.assert_allclose(area, area[0], rtol=1e-9)
    assert density[-1] == 1.0


@pytest.mark.parametrize("n", [1, 2, 25])
def test_short_arrays_are_as_good_as_long_ones(n, rng):
    """Each call starts a sequence of its own; neighbours, rows and calls must not know of each other."""
    values = np.stack([draw("normal", rng, (3, n)) for _ in range(60_000 // n)])
    assert stats.kstest(values.ravel(), "norm").pvalue > 1e-4
    columns = values.reshape(len(values), -1)
    correlation = np.corrcoef(np.hstack([columns[:-1], columns[1:]]).T)
    off = correlation[np.triu_indices_from(correlation, 1)]
    assert np.abs(off).max() < 6.0 / np.sqrt(len(columns))


def test_a_seed_determines_all_of_them():
    once, again = (draw("normal", np.random.default_rng(7), (3, 100)) for _ in range(2))
    np.testing.assert_array_equal(once, again)
    assert not np.array_equal(once, draw("normal", np.random.default_rng(8), (3, 100)))
