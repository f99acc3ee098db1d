"""Effects outside the catalogue: formulas that edit tables, and the search that finds one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from pmcl.criticism.findings.assemble import filled_in
from pmcl.criticism.naming.formulas import formulas, steady_changes, wave
from pmcl.criticism.workflow import criticize
from pmcl.filtering.estimated_path import with_estimates
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.formula import path_formulas
from pmcl.models.model_file import model_of_text, model_text
from pmcl.models.motions.odometry.motion import Differential
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


@pytest.fixture(scope="module")
def library():
    log = simulate_amigobot(120.0, 3, NOISE)
    bound = default_model(log).bind(log)
    tables = bound.tables(np.array([NOISE[name] for name in bound.names]))[0]
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    return log, tables, {effect.name: effect for effect in formulas(log, tables, path)}


def test_motion_by_alphas_has_formulas_of_its_means_only():
    log = simulate_amigobot(120.0, 3, NOISE)
    bound = RobotModel(motion=Differential(), sensors=default_model(log).sensors).bind(log)
    theta = np.array([float(p.prior.mean()) for p in bound.parameters])
    path = np.array(log.true_poses)
    found = {formula.name.removeprefix("formula: ") for formula in formulas(log, bound.tables(theta)[0], path)}
    assert {"translation *= 1 + c*speed", "turn += c*cos(heading)", "range += c*distance^2"} <= found
    assert not any(name.startswith(("log sigma_forward", "log sigma_turn")) for name in found)


def test_formulas_do_what_they_say(library):
    log, tables, library = library
    turned = library["formula: turn += c*cos(heading)"].edit(tables, [0.03], log).motion
    heading = np.unwrap(log.true_poses[:, 2])
    np.testing.assert_allclose(turned.mean[:, 2] - tables.motion.mean[:, 2], 0.03 * np.cos(heading), atol=1e-12)
    faster = library["formula: translation *= 1 + c*abs(turn_rate)"].edit(tables, [0.5], log).motion
    rate = np.abs(log.odometry[1:, 2])
    np.testing.assert_allclose(faster.mean[1:, 0], tables.motion.mean[1:, 0] * (1.0 + 0.5 * rate), atol=1e-12)
    noisier = library["formula: log sigma_turn += c*speed"].edit(tables, [2.0], log).motion
    speed = np.hypot(log.odometry[1:, 0], log.odometry[1:, 1])
    np.testing.assert_allclose(noisier.std[1:, 2], 0.04 * np.exp(2.0 * speed))
    assert sum("[x in" in name for name in library) >= 4
    longer = library["formula: range += c*cos(world_direction)"].edit(tables, [0.05], log).sensors[0]
    direction = heading[:, None] + log.beam_poses[:, 2]
    np.testing.assert_allclose(longer.extras.bias_at, 0.05 * np.cos(direction), atol=1e-12)


def test_noise_of_ranges_follows_a_rule(library):
    log, tables, library = library
    noisier = library["formula: log sigma_range += c*abs(turn_rate)"].edit(tables, [1.5], log).sensors[0]
    factor = noisier.extras.std_factor
    np.testing.assert_allclose(factor[1:], np.exp(1.5 * np.abs(log.odometry[1:, 2])))
    plain = formulas(log, tables, np.array(log.true_poses), of_noise=False)
    assert not any("sigma" in effect.name for effect in plain)


def test_null_changes_nothing_and_parts_of_a_log_work(library):
    log, tables, library = library
    part = log.select(0, 50)
    bound = default_model(part).bind(part)
    short = bound.tables(np.array([NOISE[name] for name in bound.names]))[0]
    for effect in library.values():
        same = effect.edit(tables, effect.null, log)
        np.testing.assert_array_equal(same.motion.mean, tables.motion.mean)
        np.testing.assert_array_equal(same.motion.std, tables.motion.std)
        edited = effect.edit(short, effect.magnitude("clear"), part)
        assert edited.motion.mean.shape == (50, 3)
        assert getattr(edited.sensors[0].extras, "bias_at", np.zeros((50, 8))).shape == (50, 8)


def test_formulas_are_effects_of_an_ordinary_model(library):
    log, _, library = library
    effects = list(library.values())[:3]
    bound = RobotModel(sensors=default_model(log).sensors, effects=tuple(effects)).bind(log)
    assert [name for name in bound.names if name.startswith("formula_")] == [e.parameters[0].name for e in effects]


def test_every_formula_reads_the_same_from_a_model_file(library):
    """Along the path that its values were found on, the text of a formula gives these values to the last bit."""
    log, tables, library = library
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    waves = [wave(change, log, 23.456789, 12.3456) for change in steady_changes(tables, log.n_steps)]
    known = with_estimates(log, tables, path)
    base = default_model(log)
    for effect in (*library.values(), *waves):
        text = model_text(replace(base, effects=(effect,)), log)
        (back,) = model_of_text(text, log).effects
        assert (back.name, back.summary, back.carrier) == (effect.name, effect.summary, effect.carrier)
        assert back.parameters[0].name == effect.parameters[0].name
        assert model_text(replace(base, effects=(back,), priors=model_of_text(text, log).priors), log) == text
        before, after = effect.edit(tables, [0.037], log), back.edit(tables, [0.037], known)
        for one, other in zip((before.motion, *before.sensors), (after.motion, *after.sensors), strict=True):
            assert type(one) is type(other)
            for table, like in ((one, other), (one.extras, other.extras)):
                for name in set(table._fields) - {"extras"}:
                    np.testing.assert_array_equal(
                        getattr(table, name), getattr(like, name), err_msg=f"{effect.name}: {name}"
                    )
        if not path_formulas((back,)):
            again = back.edit(tables, [0.037], log)
            np.testing.assert_array_equal(again.motion.mean, before.motion.mean)


def test_coefficient_is_filled_in():
    assert filled_in("formula: turn += c*cos(heading)", 0.0312) == "formula: turn += 0.0312*cos(heading)"
    assert filled_in("formula: translation *= 1 + c*speed", -0.25) == "formula: translation *= 1 - 0.25*speed"
    assert filled_in("formula: turn += c*speed", -0.25) == "formula: turn += -0.25*speed"


@pytest.mark.long
def test_drift_outside_the_catalogue_is_found_as_a_formula():
    def drifting(tables, values, log, where):
        mean = tables.motion.mean.copy()
        mean[:, 2] += values[0] * (log.times - 150.0)
        return tables._replace(motion=tables.motion._replace(mean=mean))

    ramp = Parameter("gyro_ramp", "rad/s^2", stats.norm(0.0, 1e-2))
    drift = Effect(
        "gyro-ramp", "The gyro warms up.", (ramp,), (0.0,), drifting, carrier="motion", typical={"clear": (4e-4,)}
    )
    log = simulate_amigobot(300.0, 3, NOISE, effects=((drift, (5e-4,)),), hide_effects=True)
    found = criticize(log, simulations=20, joint=False, seed=1, rounds=1)
    (effect,) = found.effects
    assert effect.name.startswith("formula: turn += 0.000")
    assert "time" in effect.name
    (estimate,) = effect.parameters.values()
    assert abs(estimate.mean - 5e-4) < 5.0 * estimate.sd
