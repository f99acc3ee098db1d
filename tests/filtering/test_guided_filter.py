"""The filter that a path guides: its evidence is exact for linear models and unbiased for all others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import kalman
from oracles.effect_logs import FIELD, SONAR, field_log, sonar_log
from oracles.random_walk_model import RailSensor, rail_log, rail_model

from pmcl.engine.contract import state_size, widens
from pmcl.errors import FilterError
from pmcl.filtering import guided_filter
from pmcl.filtering.guided_filter import GuidedFilter, guide_along, run_guided
from pmcl.filtering.heavy_tails import inverse_freedom, with_expected_noise
from pmcl.filtering.kernels.guided import Guide, guide_of
from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.logs.joined import join_logs
from pmcl.models.effects.selection import effect_named
from pmcl.models.robot_model import default_model

# mypy: disable-error-code="no-untyped-def"

THETA = np.array([0.5, 0.4])
# Effects of each kind of table: walls and beams, a sensor that looks back, heavy tails, a fourth state component.
EFFECTS = ("", "range-noise-correlated", "heavy-tailed-motion-noise", "turn-noise-correlated", "wheel-slip")


def fine_guide(tables, readings, path, with_readings):
    fine, *arrays = guide_of(tables, readings, path, with_readings)
    assert fine
    return Guide(path, *arrays)


@pytest.fixture
def narrow(monkeypatch):
    """All states are drawn as the linearised model has them, none more widely."""
    monkeypatch.setattr(guided_filter, "_WIDE_SHARE", 0.0)


@pytest.mark.parametrize("with_readings", [False, True])
def test_each_weight_is_the_kalman_filters_predictive_density(with_readings, narrow, rng):
    """The same for all particles, however few, along any path; also where readings are weighed one row later."""
    log = rail_log(40, seed=5, missing=(3, 4, 20))
    bound = rail_model().bind(log)
    tables = bound.tables(THETA)[0]
    model = kalman.linear_model(tables)
    exact = [float(kalman.log_evidence(model._replace(reading=model.reading[: t + 1]), *THETA)) for t in range(40)]
    path = 50.0 + rng.standard_normal((40, 1))
    linear, readings = LinearisedEvidence(bound, THETA, [path]).linear_model(0, tables)
    guide = fine_guide(linear, readings, path, False)
    counts = rng.integers(2, 9, 40)
    steps = run_guided(tables, guide, counts, [make_rng(1)]).steps
    np.testing.assert_allclose(steps[:, 0], np.diff([0.0, *exact]), atol=1e-6)
    np.testing.assert_allclose(steps[:, 1], 1.0)
    # A belief that knows the row's own readings counts them twice, unless they are weighed one row later.
    if with_readings:
        knowing = fine_guide(linear, readings, path, True)
        wrong = run_guided(tables, knowing, counts, [make_rng(1)]).steps
        assert wrong[:, 0].std() > 0.1


def test_paths_are_drawn_as_kalmans_smoother_has_them(narrow, rng):
    """In a linear model the paths of single passes are independent draws; means and covariances of neighbours agree."""
    bound = rail_model().bind(rail_log(20, seed=5, missing=(3, 4)))
    tables = bound.tables(THETA)[0]
    path = 50.0 + rng.standard_normal((20, 1))
    guide = guide_along(LinearisedEvidence(bound, THETA, [path]), 0, tables)
    counts, rngs = rng.integers(2, 9, 20), [make_rng(1)]
    drawn = np.array(
        [run_guided(tables, guide, counts, rngs, with_history=True).draw_path(tables, rng)[:, 0] for _ in range(4000)]
    )
    mean, covariance = kalman.path_posterior(kalman.linear_model(tables), *THETA)
    root = np.linalg.cholesky(covariance)
    z = np.linalg.solve(root, (drawn - mean).T)
    assert np.abs(z.mean(axis=1)).max() < 4.0 / np.sqrt(4000)
    assert np.abs(z @ z.T / 4000 - np.eye(20)).max() < 5.0 * np.sqrt(2.0 / 4000)


def true_path(log):
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    return path


@pytest.fixture(scope="module", params=EFFECTS)
def case(request):
    """A short log with a model that has an effect, its theta, the true path, and the evidence by large filters."""
    name = request.param
    log = (field_log if name == "turn-noise-correlated" else sonar_log)().select(0, 12)
    effects = tuple(effect_named(one, log) for one in (name,) if one)
    bound = replace(default_model(log), effects=effects).bind(log)
    known = {**SONAR, **FIELD} | {
        parameter.name: value
        for effect in effects
        for parameter, value in zip(effect.parameters, effect.typical["clear"], strict=True)
    }
    theta = np.array([known[one] for one in bound.names])
    tables = bound.tables(theta)[0]
    path = np.zeros((log.n_steps, int(state_size(tables.motion))))
    path[:, :3] = true_path(log)
    rng = make_rng(1)
    large = np.array([run_filter(tables, log.n_steps, 20_000, rng).log_evidence for _ in range(96)])
    return bound, theta, path, large


def relative(bound, theta, path, large, passes=3000):
    """Estimates of the evidence over that by large filters, from passes of few particles."""
    found = GuidedFilter(bound, theta, path).log_scores(60, passes, 5).sum(axis=1)
    return np.exp(found - large.max()), np.exp(large - large.max())


def differ(found, expected):
    """By how many standard errors two means differ."""
    error = np.hypot(found.std(ddof=1) / np.sqrt(found.size), expected.std(ddof=1) / np.sqrt(expected.size))
    return abs(found.mean() - expected.mean()) / error, error / expected.mean()


@pytest.mark.slow
def test_the_evidence_is_unbiased_for_any_model(case):
    """Walls, beams that remember, heavy tails, a fourth component of the state, slips: as large filters have it."""
    off, error = differ(*relative(*case))
    assert error < 0.03
    assert off < 4.0


@pytest.mark.slow
def test_it_is_unbiased_along_a_poor_path_too(case, monkeypatch, rng):
    """Without a search for a better path, a wrong one costs precision alone."""
    bound, theta, path, large = case
    monkeypatch.setattr(guided_filter, "improved", lambda evidence, theta: evidence)
    shifted = path + 0.02 * rng.standard_normal(path.shape)
    off, error = differ(*relative(bound, theta, shifted, large, passes=4000))
    assert error < 0.08
    assert off < 4.0


@pytest.mark.slow
def test_paths_have_the_means_of_smoothed_ones(case):
    """Passes weighed by their evidence, with resampling at every other row; against paths drawn backward."""
    bound, theta, path, _ = case
    tables, rng = bound.tables(theta)[0], make_rng(9)
    guide = guide_along(LinearisedEvidence(bound, theta, [path]), 0, tables)
    counts = np.resize([40, 60], len(path))
    passes = [run_guided(tables, guide, counts, [rng], with_history=True) for _ in range(3000)]
    evidence = np.array([one.log_evidence for one in passes])
    weight = np.exp(evidence - evidence.max())
    weight /= weight.mean()
    ours = np.array([one.draw_path(tables, rng) for one in passes]) - path
    # Paths of one filter share its few particles that explain the later rows; filters are independent.
    theirs = np.array([draw_paths(tables, run_filter(tables, len(path), 10_000, rng), 50, rng) for _ in range(60)])
    for power in (1, 2):
        value, filters = weight[:, None, None] * ours**power, ((theirs - path) ** power).mean(axis=1)
        error = np.hypot(value.std(axis=0) / np.sqrt(len(value)), filters.std(axis=0, ddof=1) / np.sqrt(len(filters)))
        assert np.abs((value.mean(axis=0) - filters.mean(axis=0)) / error).max() < 4.5


@pytest.mark.slow
def test_a_bias_would_show(case):
    bound, theta, path, large = case
    found, expected = relative(bound, theta, path, large)
    assert differ(1.15 * found, expected)[0] > 4.0


@pytest.mark.slow
@pytest.mark.parametrize("seams", [(), (20,)])
def test_logs_that_were_joined_and_long_ones_have_the_evidence_of_their_filters(seams):
    """The mean over passes lies within the noise of large filters, whose noise it has not."""
    log = sonar_log(60)
    path = true_path(log)
    if seams:
        log = join_logs([log.select(0, 20), log.select(20, 60)])
    bound = default_model(log).bind(log)
    theta = np.array([SONAR[name] for name in bound.names])
    tables = bound.tables(theta)[0]
    rng = make_rng(2)
    large = np.array([run_filter(tables, 60, 20_000, rng).log_evidence for _ in range(16)])
    found = GuidedFilter(bound, theta, path).log_scores(200, 16, 3).sum(axis=1)
    assert found.std() < 1.0
    assert found.mean() == pytest.approx(large.mean(), abs=1.0 + 3.0 * large.std())


def test_steps_far_astray_widen_the_noise_of_their_rows():
    """The expected variance given a step s has the closed form (v + s^2) / (v - 1)."""
    log = field_log(60)
    effect = effect_named("heavy-tailed-motion-noise", log)
    bound = replace(default_model(log), effects=(effect,)).bind(log)
    theta = bound.prior_mean()
    theta[-1] = 0.25
    tables = bound.tables(theta)[0]
    path = true_path(log)
    path[30:, :2] += 1.0
    widened = with_expected_noise(tables, path, make_rng(1))
    assert inverse_freedom(widened) == 0.0
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    dx, dy = np.diff(path[:, :2], axis=0).T
    steps = np.column_stack([c * dx + s * dy, c * dy - s * dx, np.diff(path[:, 2])])
    deviation = (steps - tables.motion.mean[1:60]) / tables.motion.std[1:60]
    expected = np.sqrt((4.0 + deviation**2) / 3.0)
    found = widened.motion.std[1:60] / tables.motion.std[1:60]
    assert found == pytest.approx(expected, rel=0.5)
    assert np.log(found / expected).mean() == pytest.approx(0.0, abs=0.03)
    plain = default_model(log).bind(log)
    assert with_expected_noise(plain.tables(plain.prior_mean())[0], path, make_rng(1)) is not None


def test_the_best_path_counts_and_more_particles_go_where_few_are_effective():
    """The first pass tells which rows these are; the others have less noise there."""
    log = sonar_log(80)
    bound = default_model(log).bind(log)
    theta = np.array([SONAR[name] for name in bound.names])
    path = true_path(log)
    guided, asked, evidence = GuidedFilter(bound, theta, path, path), [], []

    def steps(guide, counts, rng):
        asked.append((guide, counts.copy()))
        found = np.zeros((80, 2))
        found[:, 1] = 1.0
        found[0, 0] = evidence[guide is guided._guides[1]]
        found[7, 1], found[9, 1] = 0.1, 1e-9
        return found

    guided._steps = steps
    for of_paths, best in (((5.0, 3.0), 0), ((3.0, 5.0), 1)):
        asked.clear()
        evidence[:] = of_paths
        assert guided.log_scores(100, 3, 1).shape == (3, 80)
        assert [counts.max() for _, counts in asked] == [100, 100, 2000, 2000, 2000]
        assert all(guide is guided._guides[best] for guide, _ in asked[2:])
        assert list(np.flatnonzero(asked[2][1] > 100)) == [7, 9]
        assert asked[2][1][7] == 500
    # Where readings are weighed a row later, the row before needs as many.
    guided._looks_back = True
    asked.clear()
    guided.log_scores(100, 1, 1)
    assert list(np.flatnonzero(asked[2][1] > 100)) == [6, 7, 8, 9]


def test_an_impossible_path_does_not_matter_beside_another():
    log = sonar_log(80)
    bound = default_model(log).bind(log)
    theta = np.array([SONAR[name] for name in bound.names])
    path = true_path(log)
    far = path + np.array([50.0, 0.0, 0.0])
    alone = GuidedFilter(bound, theta, path).log_scores(100, 4, 1).sum(axis=1)
    both = GuidedFilter(bound, theta, far, path).log_scores(100, 4, 1).sum(axis=1)
    assert both.mean() == pytest.approx(alone.mean(), abs=5.0)


def test_a_model_without_noise_in_some_direction_is_refused(monkeypatch):
    log = field_log(60)
    bound = default_model(log).bind(log)
    monkeypatch.setattr(guided_filter, "guide_of", lambda *_: (False,))
    with pytest.raises(FilterError, match="no Gaussian path; give the motion model noise in every direction"):
        GuidedFilter(bound, bound.prior_mean(), np.array(log.true_poses))


@pytest.mark.slow
def test_a_filter_with_heavy_tails_draws_widely_and_stays_exact():
    """The wide draws are weighed: as the narrow ones have it in the mean."""
    log = sonar_log().select(0, 12)
    bound = replace(default_model(log), effects=(effect_named("heavy-tailed-motion-noise", log),)).bind(log)
    tables = bound.tables(np.array([*(SONAR[name] for name in bound.names[:4]), 0.3]))[0]
    path, rng = true_path(log), make_rng(4)
    assert widens(tables.motion)
    found = np.array([run_filter(tables, 12, 2000, rng).log_evidence for _ in range(300)])
    guided = GuidedFilter(bound, np.array([*(SONAR[name] for name in bound.names[:4]), 0.3]), path)
    exact = guided.log_scores(500, 40, 1).sum(axis=1)
    off, error = differ(np.exp(found - exact.mean()), np.exp(exact - exact.mean()))
    assert error < 0.05
    assert off < 4.0


def test_a_sensor_without_linearisation_guides_as_well(monkeypatch, rng):
    """Its readings are expanded by differences of their density; for a linear model that is exact."""
    bound = rail_model().bind(rail_log(40, seed=5, missing=(3, 4, 20)))
    exact = float(kalman.log_evidence(kalman.linear_model(bound.tables(THETA)[0]), *THETA))
    monkeypatch.setattr(RailSensor, "linearise", staticmethod(lambda table, reference: None))
    found = GuidedFilter(bound, THETA, 50.0 + rng.standard_normal((40, 1))).log_scores(500, 8, 1).sum(axis=1)
    assert found.mean() == pytest.approx(exact, abs=0.2)
