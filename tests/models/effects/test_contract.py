"""What every effect of the catalogue keeps to."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest
from oracles.effect_logs import (
    BY_NAME,
    LOGS,
    NAMES,
    base_tables,
    field_log,
    instance,
    log_for,
    model_with,
    row_densities,
    sonar_log,
    true_values,
)

from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.effects.effect import MAGNITUDES
from pmcl.models.effects.registry import candidates
from pmcl.models.model_file import model_of_text, model_text
from pmcl.models.parameters import prior_support, prior_table
from pmcl.models.tables import uniform
from pmcl.sampling.checkpoint import fingerprint

UNITS = {"m", "rad", "s", "1", "rad/m", "rad/s", "m/s", "1/m"}
EVERY = pytest.mark.parametrize("name", NAMES)


@pytest.fixture
def case(name):
    """An instance, its log, plain tables at the true parameters, and the true path."""
    log = log_for(BY_NAME[name])
    return instance(BY_NAME[name], log), log, base_tables(log), np.array(log.true_poses)


@EVERY
def test_an_effect_describes_itself(name):
    effect = BY_NAME[name]
    stem = name.replace("-", "_")
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", name)
    assert effect.summary.endswith(".")
    assert effect.symptom.endswith(".")
    assert effect.references
    for parameter in effect.parameters:
        assert parameter.name.startswith(stem)
        assert parameter.unit in UNITS
        assert parameter.description
    assert all(effect.near_twins.values())


@pytest.mark.parametrize("name", [name for name in NAMES if BY_NAME[name].same_as])
def test_an_effect_that_is_another_by_name_gives_the_same_densities(name):
    """With one parameter or its negative, at every size and along every path, and with the same prior."""
    effect = BY_NAME[name]
    for other_name, holds in effect.same_as.items():
        other, logs = BY_NAME[other_name], [log for log in (make(80) for make in LOGS) if effect.applies(log)]
        assert any(map(holds, logs))
        assert not holds(sonar_log())
        spreads = [parameter.prior.std() for one in (effect, other) for parameter in one.parameters]
        assert len(set(spreads)) == 1
        for log in filter(holds, logs):
            tables, path = base_tables(log), np.array(log.true_poses) + 0.01
            for size in (0.03, -0.2):
                here = row_densities(effect.edit(tables, (size,), log), path)
                there = [row_densities(other.edit(tables, (sign * size,), log), path) for sign in (1.0, -1.0)]
                assert min(np.abs(here - one).max() for one in there) < 1e-9


@EVERY
def test_priors_hold_the_null_and_all_typical_values(name):
    effect = BY_NAME[name]
    assert set(effect.typical) == set(MAGNITUDES)
    assert prior_table(effect.parameters) is not None
    for values in (effect.null, *effect.typical.values()):
        for parameter, value in zip(effect.parameters, values, strict=True):
            low, high = prior_support(parameter.prior)
            assert low <= value <= high
    # Weakly informative: a large effect is no surprise to the prior, and neither is a small one.
    for k in effect.strengths:
        prior = effect.parameters[k].prior
        sizes = [abs(effect.typical[m][k] - effect.null[k]) for m in MAGNITUDES]
        assert sizes == sorted(sizes)
        if sizes[2] > 0.0:
            beyond = prior.sf(effect.null[k] + sizes[2]) if effect.typical["large"][k] > effect.null[k] else 1.0
            assert beyond > 1e-3


@pytest.mark.slow
@EVERY
def test_the_null_changes_nothing(case):
    effect, log, tables, path = case
    edited = effect.edit(tables, effect.null, log)
    np.testing.assert_allclose(row_densities(edited, path), row_densities(tables, path), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
@EVERY
@pytest.mark.parametrize("magnitude", MAGNITUDES)
def test_typical_magnitudes_change_the_density_and_leave_the_given_tables_alone(case, magnitude):
    effect, log, tables, path = case
    before = pickle.dumps(tables)
    edited = effect.edit(tables, effect.magnitude(magnitude), log)
    assert pickle.dumps(tables) == before
    new, old = row_densities(edited, path), row_densities(tables, path)
    assert np.isfinite(new).all()
    assert np.abs(new - old).max() > 1e-3


@EVERY
def test_probes_lead_from_the_null_to_a_clear_effect(name):
    effect = BY_NAME[name]
    np.testing.assert_array_equal(effect.probe(0.0), effect.null)
    expected = effect.magnitude("clear")
    expected[[k for k in range(len(effect.null)) if k not in effect.strengths]] = [
        value for k, value in enumerate(effect.null) if k not in effect.strengths
    ]
    np.testing.assert_allclose(effect.probe(1.0), expected)
    for k in effect.strengths:
        low, high = prior_support(effect.parameters[k].prior)
        assert effect.one_sided(k) == (effect.null[k] in (low, high))
        assert effect.squared <= effect.one_sided(k)


@pytest.mark.slow
@EVERY
def test_scores_at_the_null_are_finite_and_not_all_zero(case):
    """The slope of the log density along the probe exists: two small steps give the same slope."""
    effect, log, tables, path = case
    if effect.name == "quantized-readings":
        pytest.skip("rounding by less than the noise hardly changes a density: what shows it are the digits")
    null = row_densities(effect.edit(tables, effect.null, log), path)
    for k in effect.strengths:
        small, smaller = (
            (row_densities(effect.edit(tables, effect.probe(h, k), log), path) - null) / h for h in (1e-4, 5e-5)
        )
        assert np.isfinite(small).all()
        # A beam may cross the edge of a wall between the two.
        near = np.isclose(small, smaller, rtol=0.05, atol=1e-2 * np.abs(small).max())
        assert near.mean() > 0.9
        assert np.abs(small).max() > 0.0


@pytest.mark.slow
@EVERY
def test_an_effect_composes_with_every_other_of_its_log(case):
    effect, log, tables, path = case
    alone = row_densities(effect.edit(tables, effect.magnitude("clear"), log), path)
    for other in CATALOGUE:
        if not other.applies(log):
            continue
        other = instance(other, log, 0)
        both = effect.edit(other.edit(tables, other.null, log), effect.magnitude("clear"), log)
        np.testing.assert_allclose(row_densities(both, path), alone, rtol=1e-8, atol=1e-8, err_msg=other.name)
        large = effect.edit(other.edit(tables, other.magnitude("clear"), log), effect.magnitude("clear"), log)
        assert np.isfinite(row_densities(large, path)).all(), other.name


@pytest.mark.slow
@EVERY
def test_a_model_with_the_effect_is_an_ordinary_model(case, tmp_path):
    effect, log, tables, path = case
    model = model_with(log, effect)
    bound = model.bind(log)
    names = tuple(parameter.name for parameter in effect.parameters)
    assert bound.names[-len(names) :] == names
    theta = np.concatenate([true_values(log), effect.magnitude("clear")])
    # Rounded alike only by the same machine code, which is that of the same table types.
    expected = row_densities(uniform(effect.edit(tables, effect.magnitude("clear"), log)), path)
    np.testing.assert_array_equal(row_densities(bound.tables(theta)[0], path[:, :3]), expected)
    np.testing.assert_array_equal(
        row_densities(pickle.loads(pickle.dumps(bound)).tables(theta)[0], path[:, :3]), expected
    )
    back = model_of_text(model_text(model, log), log)
    assert [(e.name, e.where) for e in back.effects] == [(effect.name, effect.where)]
    assert fingerprint(back.bind(log), {}) == fingerprint(bound, {})
    assert fingerprint(back.bind(log), {}) != fingerprint(model_with(log).bind(log), {})
    held = model_with(log, effect, fixed={names[0]: effect.magnitude("clear")[0]})
    assert names[0] not in held.bind(log).names


def test_instances_of_one_effect_are_told_apart_and_survive_the_file():
    log = sonar_log()
    beams = BY_NAME["beam-bias"].instances(log)
    model = model_with(log, beams[2], beams[5], BY_NAME["range-bias"])
    assert model.bind(log).names[-3:] == ("beam_bias_2", "beam_bias_5", "range_bias")
    back = model_of_text(model_text(model, log), log)
    assert back.bind(log).names == model.bind(log).names
    one = model_with(log, beams[5])
    assert one.bind(log).names[-1] == "beam_bias"
    theta = np.concatenate([true_values(log), [0.1, -0.2, 0.0]])
    bias = model.bind(log).tables(theta)[0].sensors[0].bias
    np.testing.assert_allclose(bias, [0, 0, 0.1, 0, 0, -0.2, 0, 0])


def test_candidates_hold_every_effect_somewhere():
    offered = {effect.name for make in LOGS for effect in candidates(make())}
    assert offered == set(NAMES)
    assert sum(effect.name == "beam-bias" for effect in candidates(sonar_log())) == 8
    assert not any(effect.carrier == "range" for effect in candidates(field_log()))


@EVERY
def test_twins_are_in_the_catalogue(name):
    assert set(BY_NAME[name].near_twins) <= set(NAMES) - {name}
