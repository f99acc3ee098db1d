"""What to record next: the drive that tells explanations apart, and how surely it does."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import special, stats

from pmcl.criticism.findings.json_text import effect_entry
from pmcl.criticism.findings.parts import FoundEffect
from pmcl.criticism.findings.verdict import next_drive_of
from pmcl.criticism.fitting import next_drive as module
from pmcl.criticism.fitting.next_drive import SECONDS, TOLD, NextDrive, chances_of_telling, next_drive
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model
from pmcl.simulations import simulate_landmark_field
from pmcl.simulations.drives import drives_for, simulated_pieces
from pmcl.streams import stream

# mypy: disable-error-code="no-untyped-def"

BASE = {
    "sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.03, "sigma_landmark_range": 0.2, "sigma_bearing": 0.05,
}  # fmt: skip


@pytest.fixture(scope="module")
def log():
    return simulate_landmark_field(300, 4, bearings=True)


def explanation(log, name, value):
    """A fit of a model with one effect, as a search has it."""
    base = default_model(log.without_truth())
    model = replace(base, effects=(effect_named(name, log),))
    bound = model.bind(log)
    theta = np.array([BASE.get(parameter, value) for parameter in bound.names])
    path = log.dataset["true_pose"].values.copy()
    path[:, 2] = np.unwrap(path[:, 2])
    return SimpleNamespace(model=model, fit=SimpleNamespace(theta=theta, path=path))


@pytest.mark.slow
def test_the_drive_is_one_in_which_the_effects_act(log):
    """A turn scale acts where the robot turns, and a forward scale where it drives; standing still tells nothing."""
    turn, forward = (explanation(log, f"odometry-{what}-scale", 0.15) for what in ("turn", "forward"))
    drives = {drive.name: drive for drive in drives_for(log, turn.fit.path, sideways=False)}
    pair = [turn, forward]
    chance = {name: chances_of_telling(one, pair, log, particles=300, seed=1)[0] for name, one in drives.items()}
    assert chance["stand still"] < 0.05
    best = next_drive([turn, forward], log, particles=300, seed=1)
    assert best == NextDrive(max(chance, key=lambda name: chance[name]), SECONDS, (max(chance.values()),))
    assert best.probabilities[0] > 0.9


@pytest.mark.slow
def test_a_mount_that_is_turned_and_a_bias_of_all_bearings_are_one_and_the_same(log):
    yaw, bias = explanation(log, "sensor-yaw", -0.1), explanation(log, "bearing-bias", 0.1)
    turn = explanation(log, "odometry-turn-scale", 0.15)
    best = next_drive([yaw, bias, turn], log, particles=300, seed=1)
    same, other = best.probabilities
    assert same < 0.2
    assert other > 0.9  # one that cannot be told does not hide one that can


def test_the_heading_at_the_start_is_not_known_beforehand(log):
    """A turned sensor and a slide to the side differ in the heading of the robot alone, which a drive has to find."""
    pair = [explanation(log, "sensor-yaw", -0.1), explanation(log, "odometry-side-drift", 0.1)]
    drives = {drive.name: drive for drive in drives_for(log, pair[0].fit.path, sideways=False)}
    for name in ("stand still", "drive straight, forward and back"):
        assert chances_of_telling(drives[name], pair, log, particles=300, seed=1)[0] < 0.6


def test_the_chance_is_that_of_a_normal_number(log, monkeypatch):
    """Twelve pieces of sixteen rows, whose gains are made up; either explanation may be the true one."""
    drive = drives_for(log, log.dataset["true_pose"].values, sideways=False)[0]
    gains = {"first": np.linspace(0.1, 0.5, 48), "second": np.linspace(-0.5, 1.1, 48)}

    def pieces(drive, log, path, model, theta, rng, start_std, times):
        assert start_std == module._START_STD
        return [model.truth] * 12 * times, []

    def trial(name):
        bound = SimpleNamespace(lengths=[16] * 48, tables=lambda theta: [(name, k) for k in range(48)])
        model = SimpleNamespace(truth=name, bind=lambda logs: SimpleNamespace(truth=logs[0], **vars(bound)))
        return SimpleNamespace(model=model, fit=SimpleNamespace(theta=None, path=None))

    truth = []

    def run_filter(tables, length, particles, rng):
        name, k = tables
        rows = np.full(length, gains[name][k] / (length - module._FINDING) if name == truth[-1] else 0.0)
        rows[: module._FINDING] = 1000.0 if name == "first" else 0.0  # where the pose is found, nothing counts
        return SimpleNamespace(log_increments=rows)

    def pieces_of(*given):
        logs, paths = pieces(*given)
        truth.append(logs[0])
        return logs, paths

    monkeypatch.setattr(module, "simulated_pieces", pieces_of)
    monkeypatch.setattr(module, "run_filter", run_filter)
    monkeypatch.setattr(module, "drives_for", None)
    (chance,) = chances_of_telling(drive, [trial("first"), trial("second")], log, particles=10, seed=1)
    n = SECONDS / float(np.median(np.diff(log.times))) / (16 - module._FINDING)
    expected = [
        special.ndtr((n * gain.mean() - np.log(9.0)) / np.sqrt(n * (1.0 + n / 48) * gain.var(ddof=1)))
        for gain in gains.values()
    ]
    assert chance == pytest.approx(min(expected))
    assert expected[0] != pytest.approx(expected[1], abs=0.01)


def test_nothing_is_recommended_where_the_state_is_no_pose(log):
    one = explanation(log, "sensor-yaw", 0.1)
    one.fit.path = one.fit.path[:, :1]
    assert next_drive([one, one], log, particles=100, seed=1) is None


@pytest.mark.long
@pytest.mark.parametrize("size", [0.015, 0.03, 0.15])
def test_drives_tell_the_truth_as_often_as_promised(log, size):
    """Drives of two minutes, drawn anew: the share of them after which the true one of two has 90 % probability."""
    pair = [explanation(log, f"odometry-{what}-scale", size) for what in ("turn", "forward")]
    drive = {one.name: one for one in drives_for(log, pair[0].fit.path, sideways=False)}["drive as in this log"]
    promised = np.mean([chances_of_telling(drive, pair, log, particles=300, seed=k)[0] for k in range(10)])
    pieces = round(SECONDS / np.median(np.diff(log.times)) / (drive.commands.shape[1] - module._FINDING))
    assert pieces <= len(drive.starts)
    told: list[list[bool]] = [[], []]
    for which, (truth, wrong) in enumerate((pair, pair[::-1])):
        for k in range(60):
            rng = module.make_rng(stream(99, "fresh drive", which, k))
            logs, _ = simulated_pieces(drive, log, truth.fit.path, truth.model, truth.fit.theta, rng, module._START_STD)
            logs = logs[:pieces]
            right, other = (
                module._densities(each.model.bind(logs), each.fit.theta, 300, k) for each in (truth, wrong)
            )
            told[which].append((right - other).sum() > special.logit(TOLD))
    least = min(told, key=sum)
    print(f"promised {promised:.3f}, told {np.mean(least):.3f}")
    low, high = stats.binomtest(int(np.sum(least)), len(least)).proportion_ci(0.999)
    assert low <= promised <= high


def test_the_sentence_says_which_twins_a_drive_tells_and_which_it_does_not():
    found = FoundEffect(
        "sensor-yaw", "", {}, {}, 1e-6, 0.0, 0.0, ("bearing-bias", "odometry-arc"),
        record_next=NextDrive("turn in place, both ways", 120.0, (0.04, 0.97)),
    )  # fmt: skip
    told, untold = next_drive_of(found)
    assert told == (
        "record 2 minutes of 'turn in place, both ways' next, which tell it from odometry-arc with a probability of "
        "97 %"
    )
    assert untold == "no drive that was tried is likely to tell it from bearing-bias"
    assert effect_entry(found, (0.0, 1.0))["record_next"] == {
        "name": "turn in place, both ways", "seconds": 120.0, "probabilities": (0.04, 0.97),
    }  # fmt: skip
    assert next_drive_of(replace(found, record_next=None)) == ()
    assert effect_entry(replace(found, record_next=None), (0.0, 1.0))["record_next"] is None
