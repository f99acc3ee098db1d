"""What the random numbers of pmcl.engine.random_numbers bring against those of NumPy's generator in compiled code.

``ns_per_number`` stands in the extra info of each benchmark: compare the two sources at one number of particles.
"""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.engine.compile import entry
from pmcl.engine.random_numbers import exponentials_into, normals_into
from pmcl.filtering.particle_filter import make_rng


@entry
def normals_of_pmcl(rng, out, outside, rounds):
    for _ in range(rounds):
        normals_into(rng, out, outside)


@entry
def normals_of_numpy(rng, out, outside, rounds):
    for _ in range(rounds):
        for d in range(out.shape[0]):
            for i in range(out.shape[1]):
                out[d, i] = rng.standard_normal()


@entry
def exponentials_of_pmcl(rng, out, outside, rounds):
    for _ in range(rounds):
        for d in range(out.shape[0]):
            exponentials_into(rng, out[d], outside)


@entry
def exponentials_of_numpy(rng, out, outside, rounds):
    for _ in range(rounds):
        for d in range(out.shape[0]):
            for i in range(out.shape[1]):
                out[d, i] = rng.standard_exponential()


FUNCTIONS = {
    ("normal", "pmcl"): normals_of_pmcl,
    ("normal", "numpy"): normals_of_numpy,
    ("exponential", "pmcl"): exponentials_of_pmcl,
    ("exponential", "numpy"): exponentials_of_numpy,
}
ROUNDS = 1000


@pytest.mark.parametrize("n", [25, 500])
@pytest.mark.parametrize("source", ["pmcl", "numpy"])
@pytest.mark.parametrize("law", ["normal", "exponential"])
def test_three_numbers_for_each_of_n_particles(benchmark, law, source, n):
    function, rng = FUNCTIONS[law, source], make_rng(1)
    out, outside = np.empty((3, n)), np.empty(n)
    benchmark(function, rng, out, outside, ROUNDS)
    benchmark.extra_info["ns_per_number"] = benchmark.stats["min"] / (ROUNDS * out.size) * 1e9
    assert np.isfinite(out).all()
