"""Effective draws per CPU second of the default sampler, one chain after the other on one thread, after burn-in."""

from __future__ import annotations

import time

import pytest

from pmcl.calibration import ParticleGibbs
from pmcl.logs.barfoot import read_barfoot
from pmcl.logs.mrclam import read_mrclam
from pmcl.models.robot_model import default_model
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.diagnostics import summarize
from pmcl.sampling.options import RunOptions
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

AMIGOBOT_THETA = {"sigma_forward": 0.02, "sigma_left": 0.01, "sigma_turn": 0.03, "sigma_range": 0.05}


class Serial:
    """A pool that is none."""

    map = staticmethod(map)


def measure(log, draws: int, **changes) -> dict[str, float]:
    bound = default_model(log).bind(log)
    spent = {}
    for n in (2, draws):
        method, options = ParticleGibbs(**changes), RunOptions(draws=n, trajectories=2, seed=1, pool=Serial())
        began = time.process_time()
        chains = method.run(bound, options)
        spent[n] = time.process_time() - began
    summary = summarize(to_arviz(chains, bound.parameters, bound.logs))
    worst = float(summary["ess_bulk"].min())
    return {
        "worst_ess": worst,
        "cpu_seconds": spent[draws] - spent[2],
        "burn_in_cpu_seconds": spent[2],
        "worst_ess_per_cpu_second": worst / (spent[draws] - spent[2]),
        "r_hat": float(summary["r_hat"].max()),
    }


LOGS = {
    "landmarks-400": lambda data: simulate_landmark_field(400, 1),
    "landmarks-2000": lambda data: simulate_landmark_field(2000, 1),
    "amigobot-400": lambda data: simulate_amigobot(400.0, 1, AMIGOBOT_THETA),
    "mrclam6-robot1": lambda data: read_mrclam(data / "mrclam6", robot=1, period=0.5),
    "mrclam6-robot2": lambda data: read_mrclam(data / "mrclam6", robot=2, period=0.5),
    "lost-in-the-woods": lambda data: read_barfoot(data / "lost_in_the_woods"),
}


@pytest.mark.parametrize("name", LOGS)
def test_effective_draws_per_cpu_second(benchmark, name, request):
    data = request.getfixturevalue("shared_data") if name not in list(LOGS)[:3] else None
    log = LOGS[name](data)
    measure(log, 3)  # compile
    benchmark.extra_info.update(benchmark.pedantic(measure, (log, 300), rounds=1))
    print(name, {key: round(value, 3) for key, value in benchmark.extra_info.items()})
