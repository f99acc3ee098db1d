"""The installed examples run and find what they simulate, and the command line copies them whole."""

from __future__ import annotations

import importlib
import re

import numpy as np
import pytest
from click.testing import CliRunner

from pmcl import registry
from pmcl.cli.commands import pmcl as application
from pmcl.examples import apriltags, example_names, example_text, own_robot, own_sensor
from pmcl.geometry import wrap


@pytest.fixture(autouse=True)
def own_sensor_registered(only_own_parts):
    """The sensor of the example, as its import leaves it."""
    registry.register(registry.SENSORS, "compass", own_sensor.Compass)


def run(*arguments):
    return CliRunner().invoke(application, list(arguments))


def test_the_command_lists_prints_and_copies(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    listed = run("example")
    assert [line.split()[0] for line in listed.stdout.splitlines()] == list(example_names())
    assert all(re.search(r"\w+ +[A-Z].*[^.]\.?$", line) for line in listed.stdout.splitlines())
    assert run("example", "own_effect").stdout == example_text("own_effect")
    assert run("example", "own_effect", "-o", "mine.py").exit_code == 0
    assert (tmp_path / "mine.py").read_text(encoding="utf-8") == example_text("own_effect")


def test_a_copy_never_replaces_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("precious")
    refused = run("example", "own_effect", "-o", "mine.py")
    assert refused.exit_code == 2
    assert "exists and may hold your changes" in refused.stderr
    assert (tmp_path / "mine.py").read_text() == "precious"
    assert "did you mean 'own_robot'" in run("example", "own_robto").stderr
    assert "'pmcl example' lists them" in run("example", "submarine").stderr


@pytest.mark.parametrize("name", example_names())
def test_examples_are_short_and_import(name):
    assert len(example_text(name).splitlines()) < 100
    assert callable(importlib.import_module(f"pmcl.examples.{name}").main)


def test_recordings_become_logs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own_robot.record(duration=30.0)
    log = own_robot.read_log()
    assert log.n_steps == 150
    assert log.n_readings > 30
    seen = apriltags.log_of(apriltags.record(duration=30.0))
    assert seen.n_steps == 120
    assert seen.n_readings > 40


EXPECTED = {
    # Posterior means that 200 draws give of what each example simulates, within five posterior standard deviations.
    "own_robot": ("sigma_landmark_range", 0.05, 0.015),
    "apriltags": ("sigma_landmark_range", 0.06, 0.015),
    "own_effect": ("torque_steer", 0.6, 0.3),
}


def exact_compass_noise():
    """Mean and standard deviation of sigma_compass given the compass and the odometry's turns, by a Kalman filter.

    A grid over both standard deviations. Distances to landmarks tell next to nothing more about the heading.
    """
    log, prior = own_sensor.record(), own_sensor.Compass.parameters[0].prior
    reading, turn = log.dataset["compass"].values, log.odometry[:, 2]
    sigma_turn, sigma = np.meshgrid(np.linspace(0.005, 0.07, 60), np.linspace(0.02, 0.08, 80), indexing="ij")
    mean, variance, logp = log.start_mean[2], np.full(sigma.shape, log.start_std[2] ** 2), prior.logpdf(sigma)
    for t in range(log.n_steps):
        if t > 0:
            mean, variance = mean + turn[t], variance + sigma_turn**2
        error, total = wrap(reading[t] - mean), variance + sigma**2
        logp = logp - 0.5 * np.log(total) - 0.5 * error**2 / total
        mean, variance = mean + variance / total * error, variance * sigma**2 / total
    weight = np.exp(logp - logp.max())
    centre = np.average(sigma, weights=weight)
    return centre, np.sqrt(np.average((sigma - centre) ** 2, weights=weight))


@pytest.mark.long
def test_the_sensor_of_the_example_gives_the_exact_posterior(tmp_path, monkeypatch, capsys):
    own_sensor.main(draws=500)
    mean, spread = (float(x) for x in re.search(r"= ([\d.]+) \+- ([\d.]+)", capsys.readouterr().out).groups())
    exact, exact_spread = exact_compass_noise()
    # A thousand effective draws or more: five Monte Carlo errors are a sixth of a standard deviation.
    assert abs(mean - exact) < exact_spread / 6.0 + 1e-4
    assert spread == pytest.approx(exact_spread, rel=0.15)


# Two of them are in the README as well, whose commands run among the slow tests.
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name == "apriltags" else pytest.mark.long) for name in EXPECTED],
)
def test_examples_find_what_they_simulate(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    importlib.import_module(f"pmcl.examples.{name}").main(draws=200)
    parameter, truth, near = EXPECTED[name]
    found = re.search(rf"{parameter} = ([\d.]+)", capsys.readouterr().out)
    assert found, "the example prints its posterior mean"
    assert abs(float(found[1]) - truth) < near


def test_every_example_is_run():
    assert {*EXPECTED, "own_sensor", "own_statistic"} == set(example_names())


@pytest.mark.long
def test_the_statistic_of_the_example_tells_which_ranges_are_off(capsys):
    importlib.import_module("pmcl.examples.own_statistic").main()
    steady, tilted = (float(p) for p in re.findall(r"p = ([\d.e+-]+);", capsys.readouterr().out))
    assert steady > 0.01
    assert tilted < 1e-4
