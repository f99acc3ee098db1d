"""Small fleets and jobs that tests of fleets share; processes import it by name."""

from __future__ import annotations

import os
import pickle
import signal
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmcl.calibration.particle_gibbs import ParticleGibbs
from pmcl.posterior.compat import attributes, find_group, group_names
from pmcl.simulations.amigobot import simulate_amigobot

# As short as a run can be that has all its stages.
SHORT = {
    "method": ParticleGibbs(sweeps_per_draw=1).shortest(),
    "draws": 15,
    "chains": 2,
    "trajectories": 5,
    "seed": 3,
}


def small_fleet(robots: int = 3, duration: float = 20.0) -> dict[str, object]:
    return {f"robot{k}": simulate_amigobot(duration, seed=k) for k in range(robots)}


def assert_same(one, other) -> None:
    """All numbers of two posteriors are equal bit by bit, and so is what they say of the run."""
    assert set(group_names(one)) == set(group_names(other))
    for name in group_names(one):
        left, right = find_group(one, name), find_group(other, name)
        assert set(left.variables) == set(right.variables), name
        for variable in left.variables:
            np.testing.assert_array_equal(left[variable].values, right[variable].values, err_msg=f"{name}/{variable}")
    mark = {"fleet_key"}
    texts = [{k: v for k, v in attributes(data).items() if k not in mark} for data in (one, other)]
    assert texts[0] == texts[1]


@dataclass(frozen=True)
class Square:
    """Returns the square of a number; fails at 3."""

    number: int

    def __call__(self, tell) -> int:
        tell("robot", f"squaring {self.number}")
        if self.number == 3:
            raise ArithmeticError("three is\nnot for me")
        return self.number**2


@dataclass(frozen=True)
class KilledAtFirst:
    """Kills its own process so many times, as the system does when memory is short."""

    mark: str
    times: int

    def __call__(self, tell) -> str:
        marks = [Path(f"{self.mark}{k}") for k in range(self.times)]
        for mark in marks:
            if not mark.exists():
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
        return "alive"


class Parcels:
    """A pool whose work passes through bytes both ways, as between machines, but stays in this process."""

    def map(self, function, items):
        parcel = pickle.dumps(function)
        return [pickle.loads(pickle.dumps(pickle.loads(parcel)(pickle.loads(pickle.dumps(item))))) for item in items]
