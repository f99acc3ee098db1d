"""Densities are of the numbers in the file, whatever their unit: over all readings there can be, they sum to one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import trapezoid

from pmcl.preflight.check import _usual_noise
from pmcl.preflight.hypotheses import hypotheses_of
from pmcl.preflight.readings import Sensors
from pmcl.preflight.stretch import RowReadings
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

NOTHING = np.empty(0)
NONE = np.empty(0, dtype=np.int64)


@cache
def field():
    return simulate_landmark_field(20, 1, bearings=True)


@cache
def sonars():
    return simulate_amigobot(20.0, 1)


@cache
def sensors_of(make):
    return Sensors(make(), hypotheses_of(make()), _usual_noise(make(), None))


def density(make, way, read):
    """Density of one row's reading at one pose, under one way to read the log."""
    log, sensors = make(), sensors_of(make)
    pose = (np.array([[value]]) for value in log.start_mean)
    return float(np.exp(sensors.log_density(read, np.array([way]), np.array([0.7]), *pose)[0, 0]))


def sighting(range=np.nan, bearing=np.nan):
    return RowReadings(np.array([5]), np.array([range]), np.array([bearing]), np.array([np.nan]), NONE, NOTHING)


def numbers_of(log, *names):
    return [k for k, way in enumerate(hypotheses_of(log)) if way.name in ("", *names)]


@pytest.mark.parametrize(
    "way", numbers_of(field(), "bearings-in-degrees", "bearing-sign-flipped", "bearings-in-world-frame")
)
def test_bearings_sum_to_one(way):
    half = np.pi / abs(hypotheses_of(field())[way].bearing_factor)
    grid = np.linspace(-half, half, 1001)
    values = [density(field, way, sighting(bearing=z)) for z in grid]
    assert trapezoid(values, grid) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("way", numbers_of(field(), "ranges-in-millimetres", "ranges-in-centimetres"))
def test_distances_sum_to_one(way):
    log = field()
    longest = np.hypot(*np.ptp(log.landmarks.positions, axis=0)) / hypotheses_of(log)[way].range_factor
    grid = np.linspace(0.0, longest, 2001)
    values = [density(field, way, sighting(range=z)) for z in grid]
    assert trapezoid(values, grid) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("way", numbers_of(sonars(), "ranges-in-millimetres", "map-mirrored"))
def test_echoes_zero_and_no_echo_sum_to_one(way):
    log = sonars()
    hypothesis = hypotheses_of(log)[way]
    longest = log.max_range * hypothesis.max_range_factor / hypothesis.range_factor

    def echo(z):
        return density(sonars, way, RowReadings(NONE, NOTHING, NOTHING, NOTHING, np.array([2]), np.array([z])))

    grid = np.linspace(1e-9 * longest, (1.0 - 1e-9) * longest, 2001)
    total = trapezoid([echo(z) for z in grid], grid) + echo(0.0) + echo(np.inf)
    assert total == pytest.approx(1.0, abs=2e-3)
