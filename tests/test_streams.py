"""Named streams of random numbers: none is that of another purpose, of another seed, or of a seed next to it."""

from __future__ import annotations

import numpy as np

from pmcl.criticism.naming.refits import Refits
from pmcl.criticism.settings import Settings
from pmcl.streams import stream, stream_seed

# mypy: disable-error-code="no-untyped-def, arg-type"


def test_streams_differ_by_seed_and_name():
    names = [(), ("refits",), ("guard",), ("simulated log", 0), ("simulated log", 1), ("simulated log",)]
    seeds = {stream_seed(seed, *name) for seed in range(300) for name in names}
    assert len(seeds) == 300 * len(names)
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert stream_seed(3, "refits") == stream_seed(3, "refits")
    first = np.random.Generator(np.random.SFC64(stream(0, "guard"))).random(3)
    np.testing.assert_array_equal(first, np.random.Generator(np.random.SFC64(stream(0, "guard"))).random(3))


def test_refits_of_one_run_do_not_use_the_seed_of_another():
    """Refits of seed 0 had the seed 100, and those of a run with seed 100 began where the fit of seed 100 began."""
    seeds = []
    for seed in range(250):
        refits = Refits(None, Settings(100, seed, 0.05, 30, 5, 1, False))
        seeds += [seed, refits.seed, *(stream_seed(seed, "fit of the whole log", number) for number in range(4))]
    assert len(set(seeds)) == len(seeds)
