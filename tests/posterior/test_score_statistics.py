"""Statistics of normal scores: exact values, their null distribution, and errors of known duration."""

from __future__ import annotations

import tracemalloc
import zlib

import numpy as np
import pytest
from scipy import special, stats

from pmcl.posterior import score_statistics as module
from pmcl.posterior.score_statistics import ScoreSeries, duration_of_errors, score_statistics

# mypy: disable-error-code="no-untyped-def"


def sightings(rng, n_rows=300, n_channels=5, share=0.4, interval=0.5):
    """Times and channels of readings that come and go; scores are still to be given."""
    seen = np.argwhere(rng.random((n_rows, n_channels)) < share)
    return interval * seen[:, 0], seen[:, 1]


def test_statistics_are_what_their_definitions_say(rng):
    time, channel = sightings(rng, n_rows=60, n_channels=3)
    score = rng.standard_normal(time.size) + 0.3
    names, values = score_statistics(ScoreSeries("range", time, channel, score), 3, rng)
    assert values.shape == (len(names), 4)
    found = {(one.name, one.channel, one.time_scale): value for one, value in zip(names, values[:, 0], strict=True)}
    u, n = special.ndtr(score), score.size
    assert found["shift", -1, 0.0] == pytest.approx(-np.sqrt(2 / n) * np.cos(np.pi * u).sum())
    assert found["shift", -1, 0.0] > 0.0, "readings that are longer than foreseen"
    assert found["spread", -1, 0.0] == pytest.approx(np.sqrt(2 / n) * np.cos(2 * np.pi * u).sum())
    mine = channel == 2
    assert found["channel shift", 2, 0.0] == pytest.approx(score[mine].sum() / np.sqrt(mine.sum()))
    for scale in sorted({one.time_scale for one in names} - {0.0}):
        weight = np.tril(np.exp(-(time[:, None] - time) / scale), -1) * (channel[:, None] == channel)
        expected = score @ weight @ score / np.sqrt((weight**2).sum())
        assert found["lasting", -1, scale] == pytest.approx(expected)
        rows = np.unique(time)
        mean = np.array([score[time == t].sum() / np.sqrt((time == t).sum()) for t in rows])
        weight = np.tril(np.exp(-(rows[:, None] - rows) / scale), -1)
        expected = mean @ weight @ mean / np.sqrt((weight**2).sum())
        assert found["lasting together", -1, scale] == pytest.approx(expected)


def test_standard_normal_scores_give_mean_zero_and_variance_one(rng):
    time, channel = sightings(rng)
    names, values = score_statistics(ScoreSeries("range", time, channel, np.zeros(time.size)), 4000, rng)
    simulated = values[:, 1:]
    np.testing.assert_allclose(simulated.mean(axis=1), 0.0, atol=5.0 / np.sqrt(4000))
    np.testing.assert_allclose(simulated.var(axis=1), 1.0, atol=0.15)
    # The third time scale, sixteen times a second, does not fit ten times into a log of 150 s.
    assert {one.time_scale for one in names} == {0.0, 1.0, 4.0}
    assert len(names) == 4 + 5 + 2 * 2


@pytest.mark.parametrize("seconds", [1.0, 3.0, 10.0])
def test_the_duration_of_errors_is_found(seconds):
    """Errors whose correlation falls by e in so many seconds, under white noise of the same size."""
    rng = np.random.default_rng(zlib.crc32(f"duration {seconds}".encode()))
    interval, n_rows, n_channels = 0.5, 2000, 6
    keep = np.exp(-interval / seconds)
    error = np.empty((n_rows, n_channels))
    error[0] = rng.standard_normal(n_channels)
    for t in range(1, n_rows):
        error[t] = keep * error[t - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(n_channels)
    seen = np.argwhere(rng.random(error.shape) < 0.5)
    score = (error[tuple(seen.T)] + rng.standard_normal(len(seen))) / np.sqrt(2.0)
    series = ScoreSeries("range", interval * seen[:, 0], seen[:, 1], score)
    assert 0.6 * seconds < duration_of_errors(series, "lasting") < 1.7 * seconds
    names, values = score_statistics(series, 99, rng)
    lasting = [value for one, value in zip(names, values[:, 0], strict=True) if one.name == "lasting"]
    assert max(lasting) > 10.0


def test_one_channel_has_nothing_in_common_with_others(rng):
    series = ScoreSeries("range", np.arange(50.0), np.zeros(50, dtype=np.int64), rng.standard_normal(50))
    names, _ = score_statistics(series, 9, rng)
    assert {one.name for one in names} == {"shift", "spread", "shape", "lasting"}


def test_channels_that_were_read_once_have_no_errors_that_last(rng):
    series = ScoreSeries("range", np.arange(40.0), np.arange(40), rng.standard_normal(40))
    names, values = score_statistics(series, 9, rng)
    assert not any(one.name.startswith("lasting") for one in names)
    assert np.isfinite(values).all()


def test_a_wrong_spread_is_told_by_its_sign(rng):
    time, channel = sightings(rng)
    for factor, sign in ((1.3, 1.0), (0.75, -1.0)):
        series = ScoreSeries("range", time, channel, factor * rng.standard_normal(time.size))
        names, values = score_statistics(series, 9, rng)
        spread = next(value for one, value in zip(names, values[:, 0], strict=True) if one.name == "spread")
        assert sign * spread > stats.norm.isf(1e-3)


@pytest.mark.parametrize("sectors", [(), ((0, 1), (2, 3))])
@pytest.mark.parametrize("values", [1, 50 * 21])
def test_blocks_of_any_size_give_the_same_numbers(rng, monkeypatch, values, sectors):
    time, channel = np.repeat(np.arange(100.0), 2), np.tile([0, 1], 100)
    keep = np.arange(200) % 7 != 0  # some rows have one reading
    series = ScoreSeries("x", time[keep], channel[keep], rng.standard_normal(keep.sum()), sectors)
    names, expected = score_statistics(series, 20, np.random.default_rng(1))
    monkeypatch.setattr(module, "_MOST_VALUES", values)
    names_of_blocks, found = score_statistics(series, 20, np.random.default_rng(1))
    assert names_of_blocks == names
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_memory_does_not_grow_with_readings_times_simulations(rng, monkeypatch):
    monkeypatch.setattr(module, "_MOST_VALUES", 20_000)
    series = ScoreSeries("x", np.repeat(np.arange(5000.0), 2), np.tile([0, 1], 5000), rng.standard_normal(10_000))
    tracemalloc.start()
    score_statistics(series, 199, rng)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 10_000 * 200 / 4
