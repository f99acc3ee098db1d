"""What candidates promise before they are fitted: bounds against exact evidences, large effects, and no effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.kalman import linear_model, log_evidence
from oracles.random_walk_model import rail_log, rail_model
from scipy import stats

from pmcl.criticism.fitting.quick_fit import quick_fit
from pmcl.criticism.fitting.starting_point import gain_of_motion
from pmcl.criticism.naming.promises import bounds_of
from pmcl.criticism.scoring.lower_bounds import lower_bounds
from pmcl.criticism.scoring.scores import ChangedDensity, directions_of, instance_key
from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import draw_paths, draw_paths_beside, make_rng, run_filter
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.registry import candidates
from pmcl.models.effects.selection import effect_named
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import default_model
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"


def push_scale(tables, values, log, where):
    """The cart goes farther than it was told, by this share."""
    motion = tables.motion
    return tables._replace(motion=motion._replace(control=motion.control * (1.0 + float(values[0]))))


PUSH = Effect(
    "push-scale", "pushed farther than told", (Parameter("push_scale", "1", stats.norm(scale=0.3)),), (0.0,),
    push_scale, typical={"clear": (0.1,)}, carrier="motion",
)  # fmt: skip


def test_bounds_lie_below_the_exact_evidence_and_touch_it_at_no_effect():
    """Both are parabolas of the size for a linear Gaussian model: with one slope, and the bound is the narrower one."""
    log = rail_log(150, 4)
    bound = rail_model().bind(log)
    theta = np.array([0.5, 0.4])
    tables, rng = bound.tables(theta)[0], make_rng(1)
    columns = np.ascontiguousarray(draw_paths(tables, run_filter(tables, 150, 4000, rng), 400, rng).transpose(0, 2, 1))
    change = ChangedDensity(tables, log, columns)
    model, sizes = linear_model(tables), np.array([-0.1, -0.05, 0.05, 0.1])
    exact = np.array([log_evidence(model._replace(control=model.control * (1.0 + s)), *theta) for s in sizes])
    exact -= log_evidence(model, *theta)
    below = np.array([change(PUSH, np.array([size])).sum() for size in sizes])
    slope = [np.polyfit([0.0, *sizes], [0.0, *values], 2)[1] for values in (exact, below)]
    spread = np.std([ChangedDensity(tables, log, one[None])(PUSH, np.array([0.05])).sum() for one in columns]) / 0.05
    assert abs(slope[1] - slope[0]) < 4.0 * spread / np.sqrt(len(columns))
    curvature = [np.polyfit([0.0, *sizes], [0.0, *values], 2)[0] for values in (exact, below)]
    assert curvature[1] < curvature[0] < 0.0
    assert (below < exact).mean() >= 0.75


def bounds_in(log, seed=1):
    """Bounds of all candidates of a log under its fitted default model, the greatest first."""
    fit = quick_fit(default_model(log).bind(log), seed)
    columns = draw_paths_beside(fit.tables, fit.drawn_path, 300, 5, make_rng(seed)).transpose(0, 2, 1)
    directions = directions_of(candidates(log))
    bounds = bounds_of(directions, fit, np.ascontiguousarray(columns))
    ranked = sorted(zip(directions, bounds, strict=True), key=lambda one: -one[1].evidence)
    return [(instance_key(one.effect), bound) for one, bound in ranked]


@pytest.mark.parametrize(
    ("name", "where"),
    [("beam-yaw", {"beams": [5]}), ("wall-moved", {"walls": [1]}), ("sensor-offset", {}), ("specular-reflection", {})],
)
def test_a_large_effect_has_the_greatest_bound_and_a_fit_starts_near_it(name, where):
    at = "".join(f"@{value[0]}" for value in where.values())
    log = simulate_amigobot(300.0, 4, effects=(f"{name}{at}=large",), hide_effects=True)
    key, bound = bounds_in(log)[0]
    assert key == (name, tuple((kind, tuple(values)) for kind, values in where.items()))
    assert bound.evidence > 50.0
    if name != "sensor-offset":  # its fit finds the start itself
        large = effect_named(name, log).magnitude("large")[0]
        assert 0.35 * large < bound.values[0] < 2.5 * large


def test_nothing_is_promised_where_nothing_is_missing():
    """No evidence exceeds some nats then, and no bound exceeds the evidence."""
    for seed in range(3):
        assert bounds_in(simulate_amigobot(200.0, seed), seed)[0][1].evidence < 5.0


def test_values_lie_inside_the_priors():
    log = simulate_amigobot(60.0, 1)
    fit = quick_fit(default_model(log).bind(log), 1)
    effects = candidates(log)
    for effect, bound in zip(effects, lower_bounds(fit.tables, log, fit.path.T[None].copy(), effects), strict=True):
        for value, parameter in zip(bound.values, effect.parameters, strict=True):
            assert np.isfinite(parameter.prior.logpdf(value)), effect.name


def test_the_motion_gains_by_a_sensor_at_its_true_place_alone():
    gains = {}
    for given in ((), ("sensor-offset=large",)):
        log = simulate_amigobot(300.0, 4, effects=given, hide_effects=True)
        fit = quick_fit(default_model(log).bind(log), 1)
        effect = effect_named("sensor-offset", log)
        bound = replace(default_model(log), effects=(effect,)).bind(log)
        gains[given] = gain_of_motion(bound, fit, effect)
    none, large = gains.values()
    assert abs(none) < 5.0
    assert large > 100.0


def test_a_size_that_an_effect_cannot_have_is_passed_over():
    """A user's effect may refuse a value; a smaller one still has its bound."""

    def refuses(tables, values, log, where):
        if abs(values[0]) > 0.15:
            raise ModelError("too large")
        return push_scale(tables, values, log, where)

    log = rail_log(60, 4)
    tables = rail_model().bind(log).tables(np.array([0.5, 0.4]))[0]
    columns = np.zeros((1, tables.start.mean.size, 60))
    (bound,) = lower_bounds(tables, log, columns, [replace(PUSH, change=refuses)])
    assert np.isfinite(bound.evidence)
    assert 0.0 < abs(bound.values[0]) < 0.15
