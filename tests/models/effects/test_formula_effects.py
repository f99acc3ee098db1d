"""Formulas as effects: what their terms mean, what they change, and what they refuse."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from oracles.effect_logs import base_tables, field_log, model_with, path_of, sonar_log

from pmcl.engine.tables import field_of
from pmcl.errors import ModelError
from pmcl.filtering.estimated_path import with_estimates
from pmcl.models.effects.formula import FORMULA_CARRIERS, formula_effect, path_formulas, portable
from pmcl.models.effects.terms import evaluated, motion_of_rows, needs_path, parsed
from pmcl.models.model_file import model_of_text, model_text
from pmcl.sampling.checkpoint import fingerprint

# mypy: disable-error-code="no-untyped-def"


def test_terms_are_ordinary_arithmetic():
    x, b = np.array([1.0, -2.0, 0.5]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    given = {"x": x, "distance": b, "k": 3.0}
    for text, expected in {
        "2*x + 1": 2.0 * x + 1.0,
        "-x**2/k": -(x**2) / 3.0,
        "inside(x, -2, 1)": np.array([0.0, 1.0, 1.0]),
        "min(x, 0) + max(x, k)": np.minimum(x, 0.0) + 3.0,
        "abs(x)*sin(pi/2)": np.abs(x),
        "x*distance": x[:, None] * b,
    }.items():
        np.testing.assert_allclose(evaluated(parsed(text, ["k"]), given), expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("cos(headin)", "did you mean 'heading'"),
        ("sinus(x)", "expected a known function, but got 'sinus'"),
        ("", "cannot be read"),
        ("x +", "cannot be read"),
        ("__import__('os').system('true')", "expected a known function"),
        ("x.__class__", "but got 'x.__class__'"),
        ("[1, 2][0]", r"but got '\[1, 2\]\[0\]'"),
        ("lambda: 1", "but got 'lambda: 1'"),
        ("x if y else 1", "but got 'x if y else 1'"),
        ("'a'", "expected finite numbers, but got 'a'"),
        ("True*x", "expected finite numbers, but got True"),
        ("1e999*x", "expected finite numbers"),
        ("x // 2", "but got 'x // 2'"),
        ("inside(x, 1)", "expected 3 arguments of inside, but got 2"),
        ("sin(x=1)", "argument"),
        ("x*period", "expected a known variable, but got 'period'"),
    ],
)
def test_terms_that_are_none_are_told_in_one_line(text, told):
    with pytest.raises(ModelError, match=told) as caught:
        parsed(text)
    assert "\n" not in str(caught.value)


def test_only_terms_of_pose_and_beams_need_a_path():
    assert not any(needs_path(parsed(text)) for text in ("time", "abs(turn_rate)*speed", "sin(2*pi*time)"))
    assert all(needs_path(parsed(text)) for text in ("cos(heading)", "x_before", "1 + distance", "world_direction"))


@pytest.mark.parametrize("carrier", FORMULA_CARRIERS)
def test_each_carrier_is_changed_by_coefficient_times_term_and_by_nothing_else(carrier):
    log = sonar_log()
    tables = base_tables(log)
    term = motion_of_rows(log)["speed"] * np.sin(np.asarray(log.times))
    edited = formula_effect(carrier, ["speed*sin(time)"]).edit(tables, [0.3], log)
    motion, beams = edited.motion, edited.sensors[0]
    drives = np.where(tables.motion.mean[1:, 0] == 0.0, np.nan, tables.motion.mean[1:, 0])
    changes = {
        "translation": motion.mean[1:, 0] / drives - 1.0,
        "turn": (motion.mean - tables.motion.mean)[1:, 2],
        "log sigma_forward": np.log(motion.std / tables.motion.std)[1:, 0],
        "log sigma_left": np.log(motion.std / tables.motion.std)[1:, 1],
        "log sigma_turn": np.log(motion.std / tables.motion.std)[1:, 2],
        "range": field_of(beams, "bias_at")[1:, 3],
        "log sigma_range": np.log(field_of(beams, "std_factor"))[1:],
    }
    for name, change in changes.items():
        expected = 0.3 * term[1:] if name == carrier else np.zeros(log.n_steps - 1)
        known = np.isfinite(change)
        assert known.any()
        np.testing.assert_allclose(change[known], expected[known], atol=1e-12)


def test_several_terms_add_up_inside_the_window_only():
    log = sonar_log()
    tables, times = base_tables(log), np.asarray(log.times)
    begin, end = times[10], times[40]
    effect = formula_effect("turn", ["time/length", "1"], {"length": 50.0}, (begin, end))
    assert [parameter.name for parameter in effect.parameters] == [
        "formula_turn_time_length_and_1_1", "formula_turn_time_length_and_1_2"
    ]  # fmt: skip
    change = effect.edit(tables, [0.1, -0.02], log).motion.mean[:, 2] - tables.motion.mean[:, 2]
    expected = np.where((times >= begin) & (times <= end), 0.1 * times / 50.0 - 0.02, 0.0)
    np.testing.assert_allclose(change, expected, atol=1e-15)


def test_a_term_of_the_pose_reads_the_path_that_the_log_holds():
    log = sonar_log()
    tables, path = base_tables(log), path_of(log)
    effect = formula_effect("range", ["cos(world_direction)"])
    assert path_formulas((effect,)) == (effect,)
    with pytest.raises(ModelError, match="expected a log with an estimate of its path"):
        effect.edit(tables, [0.05], log)
    # Nothing is added without one, so a model can find the path first.
    np.testing.assert_array_equal(effect.edit(tables, [0.0], log).sensors[0].extras.bias_at, 0.0)
    bias = effect.edit(tables, [0.05], with_estimates(log, tables, path)).sensors[0].extras.bias_at
    np.testing.assert_allclose(bias, 0.05 * np.cos(path[:, 2, None] + log.beam_poses[:, 2]), atol=1e-15)


def test_what_formulas_refuse():
    log = sonar_log()
    for arguments, told in (
        (("wheels", ["speed"]), "expected a formula of translation"),
        (("turn", []), "at least one term"),
        (("turn", ["speed"], {"period": 2.0}), "expected terms that use the constant 'period'"),
        (("turn", ["distance"]), "which each beam has for itself"),
        (("turn", ["speed"], None, (3.0, 2.0)), "begin < end"),
    ):
        with pytest.raises(ModelError, match=told):
            formula_effect(*arguments)
    with pytest.raises(ModelError, match="one coefficient for each of 2 terms"):
        formula_effect("turn", ["speed", "time"], coefficients=["a"])
    with pytest.raises(ModelError, match=r"finite values of the term 'log\(-speed\)'"):
        formula_effect("turn", ["log(-speed)"]).edit(base_tables(log), [0.1], log)
    field = field_log()
    with pytest.raises(ModelError, match="range beams"):
        formula_effect("range", ["speed"]).edit(base_tables(field), [0.1], field)


def test_formulas_travel_to_other_processes():
    log = sonar_log()
    effect = formula_effect("turn", ["speed"])
    edited = effect.edit(base_tables(log), [0.1], log)
    again = pickle.loads(pickle.dumps(effect))
    assert again.change == effect.change
    np.testing.assert_array_equal(again.edit(base_tables(log), [0.1], log).motion.mean, edited.motion.mean)


def test_a_portable_formula_forgets_the_log_that_it_was_found_on():
    log = sonar_log()
    tables = base_tables(log)
    bound = formula_effect("turn", ["time"], features=[np.full(log.n_steps, 7.0)])
    assert bound.edit(tables, [1.0], log).motion.mean[5, 2] == pytest.approx(tables.motion.mean[5, 2] + 7.0)
    changed = portable(bound).edit(tables, [1.0], log).motion.mean[:, 2] - tables.motion.mean[:, 2]
    np.testing.assert_allclose(changed, log.times, atol=1e-12)


def test_files_hold_terms_constants_window_and_names():
    log = sonar_log()
    effects = (
        formula_effect("turn", ["sin(2*pi*(time - begins)/period)"], {"begins": 1.0 / 3.0, "period": 60.0}, (2.0, 9.5)),
        formula_effect("range", ["cos(world_direction)", "tan(min(incidence, 1.3))"], coefficients=["a", "b"]),
    )
    model = model_with(log, *effects)
    back = model_of_text(model_text(model, log), log)
    assert [(one.name, one.change) for one in back.effects] == [(one.name, one.change) for one in effects]
    assert back.parameters[-1].name == "b"
    given = [(p.name, p.prior.dist.name, p.prior.args, p.prior.kwds) for p in model.parameters]
    assert [(p.name, p.prior.dist.name, p.prior.args, p.prior.kwds) for p in back.parameters] == given
    assert model_text(back, log) == model_text(model, log)
    assert fingerprint(back.bind(log), {}) == fingerprint(model.bind(log), {})
    other = replace(effects[0], change=replace(effects[0].change, constants={"begins": 1.0 / 3.0, "period": 50.0}))
    assert fingerprint(model_with(log, other).bind(log), {}) != fingerprint(model_with(log, effects[0]).bind(log), {})


def test_a_formula_may_have_a_name_of_its_own():
    log = sonar_log()
    named = formula_effect("turn", ["time"], name="warming gyro", coefficients=["warming"])
    (back,) = model_of_text(model_text(model_with(log, named), log), log).effects
    assert (back.name, back.change) == ("warming gyro", named.change)
