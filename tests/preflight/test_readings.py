"""Densities are of the numbers in the file, whatever their unit: over all readings there can be, they sum to one."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import trapezoid

from pmcl.models.quick import QuickReadings
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.preflight.hypotheses import hypotheses_of
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

USUAL = {"sigma_range": 0.1, "sigma_landmark_range": 0.2, "sigma_bearing": 0.1}


@cache
def field():
    return simulate_landmark_field(20, 1, bearings=True)


@cache
def sonars():
    return simulate_amigobot(20.0, 1)


@cache
def read(make):
    """The readings of the log's only sensor, the ways to read the log, and densities under each."""
    sensor = {field: LandmarkNoise, sonars: RangeNoise}[make]
    name = {field: "landmarks", sonars: "range"}[make]
    readings: QuickReadings = sensor.quick_readings(make(), USUAL)
    ways = hypotheses_of(make(), {name: readings})
    return ways, readings.under([way.for_sensor(name) for way in ways])


def density(make, way, *reading):
    """Density of one row's reading at one pose, under one way to read the log."""
    pose = (np.array([[value]]) for value in make().start_mean)
    return float(np.exp(read(make)[1].of(*reading, np.array([way]), np.array([0.7]), *pose)[0, 0]))


def sighting(range=np.nan, bearing=np.nan):
    return np.array([5]), [np.array([range]), np.array([bearing]), np.array([np.nan])]


def numbers_of(make, *names):
    return [k for k, way in enumerate(read(make)[0]) if way.name in ("", *names)]


def change_of(make, way, field, usual):
    misread = read(make)[0][way].misread
    return usual if misread is None else getattr(misread[1], field)


@pytest.mark.parametrize(
    "way", numbers_of(field, "bearings-in-degrees", "bearing-sign-flipped", "bearings-in-world-frame")
)
def test_bearings_sum_to_one(way):
    half = np.pi / abs(change_of(field, way, "bearing_factor", 1.0))
    grid = np.linspace(-half, half, 1001)
    values = [density(field, way, *sighting(bearing=z)) for z in grid]
    assert trapezoid(values, grid) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("way", numbers_of(field, "ranges-in-millimetres", "ranges-in-centimetres"))
def test_distances_sum_to_one(way):
    longest = np.hypot(*np.ptp(field().landmarks.positions, axis=0)) / change_of(field, way, "range_factor", 1.0)
    grid = np.linspace(0.0, longest, 2001)
    values = [density(field, way, *sighting(range=z)) for z in grid]
    assert trapezoid(values, grid) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("way", numbers_of(sonars, "ranges-in-millimetres", "map-mirrored"))
def test_echoes_zero_and_no_echo_sum_to_one(way):
    factors = [change_of(sonars, way, name, 1.0) for name in ("max_range_factor", "range_factor")]
    longest = sonars().max_range * factors[0] / factors[1]

    def echo(z):
        return density(sonars, way, np.array([2]), np.array([z]))

    grid = np.linspace(1e-9 * longest, (1.0 - 1e-9) * longest, 2001)
    total = trapezoid([echo(z) for z in grid], grid) + echo(0.0) + echo(np.inf)
    assert total == pytest.approx(1.0, abs=2e-3)
