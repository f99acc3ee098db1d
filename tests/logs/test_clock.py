"""Stamps in order: swapped neighbours, repeated stamps, and clocks that jump."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.logs.clock import in_order

STEADY = np.arange(100) * 0.1
YEAR = 365 * 86400.0


def test_steady_clocks_stay():
    kept, jumped = in_order(STEADY)
    assert kept.tolist() == list(range(100))
    assert jumped == 0
    assert in_order(np.empty(0))[0].size == 0
    assert in_order(np.array([5.0]))[0].tolist() == [0]


def test_swapped_neighbours_are_sorted_and_repeated_stamps_come_once():
    times = np.array([0.0, 0.2, 0.1, 0.3, 0.3, 0.4])
    kept, jumped = in_order(times)
    assert kept.tolist() == [0, 2, 1, 3, 5]
    assert jumped == 0


@pytest.mark.parametrize("wrong", [-YEAR, -20.0, 20.0, YEAR, np.nan])
@pytest.mark.parametrize("place", [0, 30, 99])
def test_one_wrong_stamp(wrong, place):
    times = STEADY.copy()
    times[place] += wrong
    kept, jumped = in_order(times)
    # The first stamp of all may be early, and the last one late: that is a pause.
    is_pause = (place == 0 and wrong == -20.0) or (place == 99 and wrong == 20.0)
    assert jumped == (0 if is_pause else 1)
    assert (place in kept) == is_pause
    assert len(kept) == 100 - jumped


def test_a_clock_that_is_set_while_recording():
    """The longer part counts; the sum of the parts before and after an excursion does, too."""
    kept, jumped = in_order(np.concatenate([STEADY[:30], STEADY[30:] + YEAR]))
    assert (kept[0], jumped) == (30, 30)
    kept, jumped = in_order(np.concatenate([STEADY[:30], STEADY[30:65] - YEAR, STEADY[65:]]))
    assert jumped == 35
    assert kept.tolist() == [*range(30), *range(65, 100)]


def test_a_pause_is_no_jump():
    times = np.concatenate([STEADY, STEADY + 600.0])
    assert in_order(times)[1] == 0


def test_a_clock_without_sense_ends_quickly():
    kept, jumped = in_order(np.random.default_rng(1).uniform(0.0, 1e9, 100_000))
    assert len(kept) + jumped == 100_000
    assert len(kept) < 10
