"""Sound logs pass without a word, also those with an effect that the model lacks."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.errors import PmclError
from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.preflight.check import preflight
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"


def _drawn_log(seed):
    """A log of any of three robots, of 60 to 400 s, with noise drawn from the priors."""
    rng = np.random.default_rng([seed, 19])
    duration, robot = int(rng.integers(60, 401)), seed % 3
    if robot < 2:
        return (simulate_amigobot, simulate_aibo)[robot](float(duration), seed)
    bearings = bool(rng.random() < 0.6)
    sensor = LandmarkNoise(range=True, bearing=bearings)
    theta = {p.name: float(p.prior.rvs(random_state=rng)) for p in (*IncrementNoise().parameters, *sensor.parameters)}
    return simulate_landmark_field(duration, seed, theta, bearings=bearings, field_of_view=3.0)


@pytest.mark.parametrize("seed", range(9))
def test_few_logs_drawn_from_the_priors_pass(seed):
    assert preflight(_drawn_log(5000 + seed)) == ()


@pytest.mark.long
def test_two_hundred_logs_drawn_from_the_priors_pass():
    assert [seed for seed in range(6000, 6200) if preflight(_drawn_log(seed))] == []


ROBOTS = {
    "amigobot": lambda effects: simulate_amigobot(150.0, 21, effects=effects),
    "aibo": lambda effects: simulate_aibo(150.0, 21, effects=effects),
    "field": lambda effects: simulate_landmark_field(150, 21, bearings=True, effects=effects),
}
# With 1.5 rad of noise in a metre, odometry really has little to do with the motion, and the field's readings show it.
TRULY_BAD = {("turn-noise-grows-with-distance", "large", "field"): {"odometry-disagrees"}}


@pytest.mark.parametrize(
    # What is large looks more like a mistake.
    "size", [pytest.param("clear", marks=pytest.mark.long), pytest.param("large", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("effect", [effect.name for effect in CATALOGUE])
def test_missing_effects_are_no_mistakes(effect, size):
    """What a model lacks is for the critic; a log with it is sound."""
    for robot, make in ROBOTS.items():
        try:
            log = make([f"{effect}={size}"])
        except PmclError:
            continue  # this robot cannot show it
        found = {finding.name for finding in preflight(log)}
        assert found == TRULY_BAD.get((effect, size, robot), set()), robot
