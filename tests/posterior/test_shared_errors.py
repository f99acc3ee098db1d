"""Beams that share their errors: sectors of scans, what is simulated of them, and how often they are objected to."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.posterior.model_check import _deviations, _Judged
from pmcl.posterior.score_statistics import ScoreSeries, score_statistics
from pmcl.posterior.shared_errors import MOST_ROWS, sectors_of, shared_normals
from pmcl.simulations.lidar_room import simulate_lidar_room

# mypy: disable-error-code="no-untyped-def"

BEAMS, WORTH = 60, 2


def grouped_scores(rng, rows, own=0.0):
    """Scores of scans whose beams fall into two groups with one error each; a share `own` of the variance is a beam's.

    Groups are neighbours and begin anywhere.
    """
    place = (np.arange(BEAMS) / BEAMS + rng.random((rows, 1))) % 1.0
    shared = np.take_along_axis(rng.standard_normal((rows, WORTH)), (place * WORTH).astype(int), axis=1)
    return np.sqrt(1.0 - own) * shared + np.sqrt(own) * rng.standard_normal((rows, BEAMS))


def judged(scores, rng, exponent=WORTH / BEAMS, seen=None):
    """Findings and p-value for scores (T, C) of rows a second apart, as the model check has them."""
    log = simulate_lidar_room(2, 0, n_rays=scores.shape[1])
    row, channel = np.nonzero(np.ones(scores.shape, dtype=bool) if seen is None else seen)
    series = ScoreSeries("scan", row.astype(float), channel, scores[row, channel])
    if exponent < 1.0:
        series = ScoreSeries("scan", *sectors_of(series.time, series.channel, series.score, exponent))
    return _deviations([_Judged(0, series, *score_statistics(series, 199, rng))], [log])


def test_sectors_hold_the_medians_of_neighbouring_beams():
    """Eight beams that are worth two make four sectors; a sector without readings is left out."""
    score = np.array([[1.0, 3.0, -1.0, 0.5, 9.0, 0.0, 2.0, 2.5], [4.0, 8.0, 0.0, 0.0, 0.0, 0.0, -5.0, -5.0]])
    seen = np.ones((2, 8), dtype=bool)
    seen[0, 5] = seen[1, 2] = seen[1, 3] = False
    row, channel = np.nonzero(seen)
    found = sectors_of(0.5 * row, channel, score[row, channel], 0.25)
    np.testing.assert_array_equal(found.time, [0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5])
    np.testing.assert_array_equal(found.sector, [0, 1, 2, 3, 0, 2, 3])
    np.testing.assert_array_equal(found.score, [2.0, -0.25, 9.0, 2.25, 6.0, 0.0, -5.0])
    assert found.members == ((0, 1), (2, 3), (4, 5), (6, 7))


@pytest.mark.parametrize(("beams", "exponent", "sectors"), [(60, 2 / 60, 4), (20, 0.1, 4), (3, 0.1, 2), (1, 0.5, 1),
                                                            (10, 0.9, 10)])  # fmt: skip
def test_there_are_two_sectors_for_each_independent_beam(beams, exponent, sectors):
    found = sectors_of(np.zeros(beams), np.arange(beams), np.zeros(beams), exponent)
    assert len(found.members) == sectors
    assert sum(found.members, ()) == tuple(range(beams))


def test_simulated_sectors_share_one_error_in_each_group(rng):
    """Of four sectors neighbours share in half of the rows, opposite ones and other rows never; all are normals."""
    rows = 3000
    time, sector = np.repeat(np.arange(rows, dtype=float), 4), np.tile(np.arange(4), rows)
    drawn = shared_normals(time, sector, 4, 3, rng).reshape(rows, 4, 3)
    assert drawn.mean() == pytest.approx(0.0, abs=5.0 / np.sqrt(2 * rows * 3))
    assert drawn.var() == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (2 * rows * 3)))
    for first, second, share in ((0, 1, 0.5), (3, 0, 0.5), (0, 2, 0.0), (1, 3, 0.0)):
        same = (drawn[:, first] == drawn[:, second]).all(axis=1)
        assert same.mean() == pytest.approx(share, abs=0.05 if share else 0.0)
    assert len(np.unique(drawn[:, :, 0])) == 2 * rows


@pytest.mark.slow
def test_scans_that_share_as_much_as_the_exponent_says_are_seldom_objected_to():
    """At a rate of 1 %, more than four of 60 happen once in a thousand times; beams taken as independent always do."""
    alarms, independent = 0, 0
    for seed in range(60):
        rng = np.random.default_rng([seed, 31])
        scores = grouped_scores(rng, int(rng.integers(30, 100)), own=float(rng.choice([0.0, 0.5])))
        alarms += bool(judged(scores, rng)[0])
    for _ in range(2):
        independent += bool(judged(grouped_scores(rng, 100), rng, exponent=1.0)[0])
    assert alarms <= 4
    assert independent == 2


def lasting(rng, rows, seconds, channels):
    """Errors of variance 1 whose correlation falls by e in so many seconds, (rows, channels)."""
    keep, error = np.exp(-1.0 / seconds), rng.standard_normal((rows, channels))
    for t in range(1, rows):
        error[t] = keep * error[t - 1] + np.sqrt(1.0 - keep**2) * error[t]
    return error


@pytest.mark.parametrize("shared", [True, False], ids=["of all beams", "of half a scan"])
def test_errors_that_last_are_named(shared):
    """Of half the variance that the model says, for four seconds: of all beams, or of either half of a scan."""
    for seed in range(4):
        rng = np.random.default_rng([seed, 32, shared])
        error = np.repeat(lasting(rng, 120, 4.0, 1 if shared else 2), BEAMS if shared else BEAMS // 2, axis=1)
        found, _ = judged(np.sqrt(0.5) * error + np.sqrt(0.5) * grouped_scores(rng, 120, own=0.5), rng)
        named = {one.name: one for one in found}
        assert {"lasting", "lasting together"} & set(named), named
        for one in named.values():
            if one.name.startswith("lasting"):
                assert 1.0 <= one.seconds <= 12.0
                assert "last about" in one.message


def test_a_sector_that_is_off_is_named_with_its_rays():
    rng = np.random.default_rng(33)
    scores = 0.5 * grouped_scores(rng, 100, own=0.5)
    scores[:, 15:30] += 0.8
    found, _ = judged(scores, rng)
    (one,) = [one for one in found if one.name == "channel shift"]
    assert one.channels == tuple(range(15, 30))
    assert one.message == "lidar ranges of rays 15 to 29 are off on average"


def test_gross_errors_of_some_beams_and_too_wide_beliefs_are_no_fault():
    """A tenth of readings far too short, everything else half as scattered as foreseen."""
    rng = np.random.default_rng(34)
    scores = 0.5 * rng.standard_normal((150, BEAMS))
    scores[rng.random(scores.shape) < 0.1] = -4.0
    assert judged(scores, rng)[0] == ()
    found, _ = judged(2.0 * grouped_scores(rng, 100), rng)
    assert "lidar ranges scatter more than the model says" in [one.message for one in found]


def test_a_long_log_is_judged_as_a_shorter_one_like_it():
    """What a deviation amounts to does not grow beyond that of so many rows."""
    rng = np.random.default_rng(35)
    values = []
    for rows in (MOST_ROWS, 9 * MOST_ROWS):
        row, channel = np.nonzero(np.ones((rows, 4), dtype=bool))
        members = ((0,), (1,), (2,), (3,))
        series = ScoreSeries("scan", row.astype(float), channel, np.full(row.size, 0.2), members)
        names, found = score_statistics(series, 199, rng)
        values.append([found[k, 0] for k, name in enumerate(names) if name.name == "channel shift"])
    np.testing.assert_allclose(values[1], values[0], rtol=0.2)
    np.testing.assert_allclose(values[0], 0.2 * np.sqrt(MOST_ROWS), rtol=0.2)
