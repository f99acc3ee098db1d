"""Scores by Fisher's identity against exact gradients of the Kalman evidence, and where they may save work."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from oracles import kalman
from oracles.random_walk_model import rail_log, rail_model
from scipy import stats

from pmcl.criticism.scoring.scores import directions_of, effect_scores, parameter_scores
from pmcl.errors import DensityError
from pmcl.filtering.kernels import smc
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.registry import candidates
from pmcl.models.effects.selection import effect_named
from pmcl.models.motions.odometry.motion import Differential
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.sensors.range_beams import scoring
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

# mypy: disable-error-code="no-untyped-def"

# Away from the best fit, so that gradients are large against their Monte Carlo error.
THETA = np.array([0.8, 0.7])


def pushed(tables, values, log, where):
    return tables._replace(motion=tables.motion._replace(control=tables.motion.control + values[0]))


def noisier(tables, values, log, where):
    (sensor,) = tables.sensors
    return tables._replace(sensors=(sensor._replace(std=math.hypot(sensor.std, values[0])),))


PUSH = Effect(
    "push", "The cart is pushed.", (Parameter("push", "m", stats.norm(0.0, 0.2)),), (0.0,), pushed, carrier="motion",
    typical={"clear": (0.2,)},
)  # fmt: skip
NOISE = Effect(
    "noise", "Readings are noisier.", (Parameter("noise", "m", stats.halfnorm(scale=0.4)),), (0.0,), noisier,
    typical={"clear": (0.4,)}, squared=True,
)  # fmt: skip


@pytest.fixture(scope="module")
def cart():
    log = rail_log(25, seed=3, missing=(3, 9))
    bound = rail_model().bind(log)
    tables = bound.tables(THETA)[0]
    scores = []
    directions = directions_of((PUSH, NOISE))
    for seed in range(30):
        rng = make_rng(seed)
        paths = draw_paths(tables, run_filter(tables, 25, 500, rng), 60, rng)
        columns = np.ascontiguousarray(paths.transpose(0, 2, 1))
        of_effects = effect_scores(tables, log, columns, directions)
        rows = np.concatenate([parameter_scores(bound, THETA, columns), of_effects])
        scores.append(rows.sum(axis=1))
    return kalman.linear_model(tables), np.array(scores), directions


def _agree(draws, exact):
    error = abs(draws.mean() - exact)
    tolerance = 5.0 * draws.std(ddof=1) / math.sqrt(draws.size)
    assert tolerance < 0.25 * abs(exact), "too few draws to see an error of a quarter"
    assert error < tolerance


@pytest.mark.parametrize("which", [0, 1])
def test_scores_of_own_parameters_are_gradients_of_the_evidence(cart, which):
    model, scores, _ = cart
    step = 1e-4 * (np.arange(2) == which)
    gradient = kalman.log_evidence(model, *(THETA + step)) - kalman.log_evidence(model, *(THETA - step))
    size = 0.02 * max(THETA[which], 0.1 * min(stats.gamma(3.0, scale=0.2).std(), 1.0))
    _agree(scores[:, which], gradient / 2e-4 * size)


def test_score_of_an_effect_is_the_gradient_of_the_evidence(cart):
    model, scores, directions = cart
    step = 1e-4
    ahead, behind = (
        kalman.log_evidence(model._replace(control=model.control + sign * step), *THETA) for sign in (1.0, -1.0)
    )
    # The log density of a path is quadratic in a push, so its central difference is its slope.
    assert directions[0].above[0] == pytest.approx(-directions[0].below[0])
    _agree(scores[:, 2], (ahead - behind) / (2.0 * step) * directions[0].above[0])


def test_effects_with_one_side_are_compared_with_none(cart):
    _, scores, directions = cart
    assert directions[1].one_sided
    assert directions[1].below[0] == 0.0
    assert directions[1].above[0] == pytest.approx(0.2)
    assert np.all(np.isfinite(scores[:, 3]))


@pytest.mark.parametrize("present", [(), ("quantized-readings",), ("range-noise-correlated",), ("cross-talk",)])
def test_beams_that_stay_the_same_are_skipped_without_a_difference(present):
    log = simulate_amigobot(40.0, 3)
    known = {effect.name: effect for effect in candidates(log)}
    base = default_model(log)
    model = replace(base, effects=tuple(known[name] for name in present))
    bound = model.bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    paths = np.array([log.dataset["true_pose"].values + 0.01 * k for k in range(3)])
    columns = np.ascontiguousarray(paths.transpose(0, 2, 1))
    # Every effect of the sensors: of one beam or all, of rays, of the map, of when readings are made.
    directions = directions_of([effect for effect in candidates(log) if effect.carrier != "motion"])
    assert len(directions) > 50
    for direction, row in zip(directions, effect_scores(tables, log, columns, directions), strict=True):
        above = direction.effect.edit(tables, direction.above, log)
        below = tables if direction.one_sided else direction.effect.edit(tables, direction.below, log)
        whole = smc.sensor_terms(above.sensors[0], columns) - smc.sensor_terms(below.sensors[0], columns)
        # One row of one trajectory counts for 50 at most.
        whole = np.clip(whole, -50.0, 50.0).mean(axis=0) / (2 - direction.one_sided)
        np.testing.assert_allclose(row, whole, atol=1e-9, err_msg=direction.effect.name)
        assert np.abs(row).max() > 1e-3 or direction.effect.name in (*present, "unmapped-obstacle")


def test_an_effect_of_one_beam_costs_one_beam(monkeypatch):
    log = simulate_amigobot(40.0, 3)
    known = {effect.name: effect for effect in candidates(log)}
    tables = known["quantized-readings"].edit(default_model(log).bind(log).tables(np.full(4, 0.05))[0], [0.1], log)
    columns = np.ascontiguousarray(log.dataset["true_pose"].values.T[None])
    seen, rays = [], []

    def counted(calls, function):
        return lambda table, *given: calls.append(len(table.bias)) or function(table, *given)

    monkeypatch.setattr(scoring, "terms_given_rays", counted(seen, scoring.terms_given_rays))
    monkeypatch.setattr(scoring, "rays_along", counted(rays, scoring.rays_along))
    effect_scores(tables, log, columns, directions_of([known["beam-bias"]]))
    assert seen == [1, 1]
    effect_scores(tables, log, columns, directions_of([known["beam-bias"], known["range-bias"], known["dead-beam"]]))
    assert rays == [8, 8]  # once for each call, however many effects there are


@pytest.mark.parametrize("present", [(), ("landmark-range-noise-grows-with-range",), ("landmark-noise-correlated",)])
def test_landmarks_that_stay_the_same_are_skipped_without_a_difference(present):
    log = simulate_landmark_field(60, 3, bearings=True)
    known = {effect.name: effect for effect in candidates(log)}
    bound = replace(default_model(log), effects=tuple(known[name] for name in present)).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    paths = np.array([log.dataset["true_pose"].values + 0.01 * k for k in range(3)])
    columns = np.ascontiguousarray(paths.transpose(0, 2, 1))
    directions = directions_of([effect for effect in candidates(log) if effect.name == "landmark-moved"])
    assert len(directions) > 5
    for direction, row in zip(directions, effect_scores(tables, log, columns, directions), strict=True):
        edited = [direction.effect.edit(tables, values, log) for values in (direction.above, direction.below)]
        above, below = (smc.sensor_terms(one.sensors[0], columns) for one in edited)
        np.testing.assert_allclose(row, 0.5 * (above - below).mean(axis=0), atol=1e-9)
        assert np.abs(row).max() > 1e-3


def test_an_effect_of_one_landmark_costs_its_sightings_unless_others_may_be_meant(monkeypatch):
    log = simulate_landmark_field(60, 3, bearings=True)
    known = {effect.name: effect for effect in candidates(log)}
    bound = default_model(log).bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    columns = np.ascontiguousarray(log.dataset["true_pose"].values.T[None])
    moved = next(effect for effect in candidates(log) if effect.name == "landmark-moved")
    counted = []
    terms = smc.sensor_terms
    monkeypatch.setattr(
        smc, "sensor_terms", lambda table, paths: counted.append(table.landmark.size) or terms(table, paths)
    )
    everything = tables.sensors[0].landmark.size
    effect_scores(tables, log, columns, directions_of([moved]))
    assert all(0 < count < everything / 2 for count in counted)
    counted.clear()
    effect_scores(known["landmark-misread"].edit(tables, [0.1], log), log, columns, directions_of([moved]))
    assert set(counted) == {everything}


@pytest.mark.slow
def test_small_parameters_of_wide_priors_have_scores():
    """An alpha far below the width of its prior is moved by less than itself, so that every density stays finite."""
    log = simulate_landmark_field(60, 5, bearings=True, reach=12.0)
    bound = RobotModel(motion=Differential(), sensors=default_model(log).sensors).bind(log)
    values = {"alpha1": 0.01, "alpha2": 1e-5, "alpha3": 1e-4, "alpha4": 1e-3}
    theta = np.array([values.get(p.name, float(p.prior.mean())) for p in bound.parameters])
    rng = make_rng(1)
    tables = bound.tables(theta)[0]
    paths = draw_paths(tables, run_filter(tables, 60, 2000, rng), 5, rng)
    scores = parameter_scores(bound, theta, np.ascontiguousarray(paths.transpose(0, 2, 1)))
    # Densities without meaning differ by the greatest change that counts, or are left out.
    assert np.abs(scores).max() < 5.0
    assert (np.abs(scores[:4]).sum(axis=1) > 0.0).all()


def broken(tables, values, log, where):
    """Edit the readings so that the density of row 7 is not a number."""
    (sensor,) = tables.sensors
    reading = sensor.reading.copy()
    reading[7] = np.inf
    return tables._replace(sensors=(sensor._replace(reading=reading, std=np.inf),))


def test_rounding_is_no_score():
    """A patch where the robot never was changes densities by rounding alone, more often to one side."""
    log = simulate_landmark_field(120, 1, bearings=True)
    (grows,) = (one for one in candidates(log) if one.name == "turn-noise-grows-with-turn")
    patch = effect_named("slippery-patch", log)
    model = replace(default_model(log), effects=(grows,))
    bound = model.bind(log)
    tables = bound.tables(bound.prior_mean())[0]
    rng = make_rng(1)
    paths = draw_paths(tables, run_filter(tables, 120, 500, rng), 10, rng)
    columns = np.ascontiguousarray(paths.transpose(0, 2, 1))
    places = ((1e3, 1e3), tuple(columns[0, :2].mean(axis=1)))
    far, near = (patch.at({"place": place}, log) for place in places)
    scores = effect_scores(tables, log, columns, directions_of((far, near)))
    assert (scores[0] == 0.0).all()
    assert np.count_nonzero(scores[1]) > 0


def test_a_density_that_is_no_number_is_no_zero_score():
    log = rail_log(25, seed=3)
    bound = rail_model().bind(log)
    effect, columns = replace(NOISE, name="mine", change=broken), np.zeros((2, 1, 25))
    with pytest.raises(DensityError, match=r"row 7.* a density is not a number where mine is scored") as caught:
        effect_scores(bound.tables(THETA)[0], log, columns, directions_of([effect]))
    assert "between noise=0 and noise=0.2" in str(caught.value)
    with pytest.raises(DensityError, match=r"row 4.* where the model is scored between process_std=0.7"):
        parameter_scores(bound, THETA, np.where(np.arange(25) == 4, np.nan, 0.0)[None, None])
