"""What evidence by a guided filter costs against that by a bootstrap filter, for the same noise.

``noise`` [nat] is the standard deviation of the log evidence from one pass to another, ``seconds_for_a_nat`` the time
of as many passes as their mean needs for a noise of one nat: the time of one times its variance.
"""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.filtering.guided_filter import GuidedFilter
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

PASSES = 16
NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04}


@pytest.mark.parametrize("sigma_range", [0.05, 0.012])
@pytest.mark.parametrize("filter_name", ["guided, 200", "bootstrap, 4000"])
def test_evidence_of_600_rows(benchmark, filter_name, sigma_range):
    log = simulate_amigobot(600.0, 1, {**NOISE, "sigma_range": sigma_range})
    bound = default_model(log).bind(log)
    theta = np.array([{**NOISE, "sigma_range": sigma_range}[name] for name in bound.names])
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    rng = make_rng(1)

    def guided():
        return GuidedFilter(bound, theta, path).log_scores(200, PASSES, 1).sum(axis=1)

    def bootstrap():
        tables = bound.tables(theta)[0]
        return np.array([run_filter(tables, log.n_steps, 4000, rng).log_evidence for _ in range(PASSES)])

    found = benchmark(guided if filter_name.startswith("guided") else bootstrap)
    noise = float(np.std(found, ddof=1))
    benchmark.extra_info["log_evidence"] = round(float(np.mean(found)), 1)
    benchmark.extra_info["noise"] = round(noise, 2)
    benchmark.extra_info["seconds_for_a_nat"] = round(benchmark.stats.stats.min / PASSES * noise**2, 4)
