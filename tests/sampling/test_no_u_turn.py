"""NUTS, which shares no density and no particle with the other methods, against them and against a known answer."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest
from oracles.monte_carlo import SHARPNESS, TOLERANCE
from scipy import stats

from pmcl.calibration import NoUTurn, ParticleGibbs, RunOptions
from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.linearised_evidence import LinearisedEvidence, improved
from pmcl.filtering.particle_filter import log_joint
from pmcl.models import LandmarkNoise
from pmcl.models.effects import effect_named
from pmcl.models.motions.increments.motion import GrowingIncrementNoise
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.posterior.compat import bulk_ess, mcse_of_mean, r_hat
from pmcl.sampling import no_u_turn
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.simulations import simulate_aibo, simulate_amigobot, simulate_landmark_field

needs_numpyro = pytest.mark.skipif(
    importlib.util.find_spec("numpyro") is None, reason="numpyro is not installed: pip install 'pmcl[nuts]'"
)


def _path(log, rng):
    path = np.array(log.true_poses, dtype=float)
    path[:, 2] = np.unwrap(path[:, 2])
    return path + 0.05 * rng.standard_normal(path.shape)


@needs_numpyro
@pytest.mark.parametrize("case", ["ranges", "both and outliers", "sizes", "priors"])
def test_the_density_written_for_jax_is_that_of_the_kernels(case, rng):
    """At random parameters and paths, constants included: no other method's posterior is another one's by a factor."""
    import jax

    if case == "sizes":
        log = simulate_aibo(40.0, seed=3)
        model = default_model(log)
    else:
        log = simulate_landmark_field(30, seed=1, bearings=case != "ranges", reach=12.0)
        model = default_model(log, outliers=case == "both and outliers")
    if case == "priors":
        families = (stats.lognorm(0.5, scale=0.05), stats.uniform(0.0, 0.3), stats.halfnorm(scale=0.1),
                    stats.expon(scale=0.2), stats.invgamma(3.0, scale=0.2))  # fmt: skip
        model = replace(model, priors=dict(zip((p.name for p in model.parameters), families, strict=True)))
    bound = model.bind(log)
    with jax.enable_x64(True):
        density = no_u_turn.log_density(bound)
        for _ in range(5):
            theta, path = bound.prior_mean() * np.exp(0.3 * rng.standard_normal(bound.dimension)), _path(log, rng)
            exact = bound.log_prior(theta) + log_joint(bound.tables(theta)[0], path)
            assert float(density(theta, [path])) == pytest.approx(exact, rel=1e-9)


@pytest.fixture(scope="module")
def tiny():
    """Few rows with precise readings, so that the model is nearly linear along the path; two parameters are unknown."""
    log = simulate_landmark_field(
        12, seed=2, theta={"sigma_landmark_range": 0.05, "sigma_bearing": 0.01, "sigma_forward": 0.1}, bearings=True
    )
    fixed = {"sigma_left": 0.03, "sigma_turn": 0.03, "sigma_bearing": 0.01}
    return RobotModel(sensors=(LandmarkNoise(),), fixed=fixed).bind(log)


@pytest.fixture(scope="module")
def exact(tiny):
    """Means and standard deviations of both logarithms, by quadrature of the linearised model's evidence."""
    log = tiny.logs[0]
    path = np.array(log.true_poses, dtype=float)
    path[:, 2] = np.unwrap(path[:, 2])
    theta = np.array([0.1, 0.05])
    evidence = improved(LinearisedEvidence(tiny, theta, [path]), theta)
    grids = np.log([0.1, 0.05])[:, None] + np.linspace(-1.3, 1.3, 61)
    u, v = np.meshgrid(*grids, indexing="ij")
    values = np.array([
        evidence(np.exp(place)) + tiny.log_prior(np.exp(place)) + place.sum()
        for place in np.stack([u.ravel(), v.ravel()], axis=1)
    ]).reshape(u.shape)  # fmt: skip
    weight = np.exp(values - values.max())
    weight /= weight.sum()
    assert max(weight[0].sum(), weight[-1].sum(), weight[:, 0].sum(), weight[:, -1].sum()) < 1e-3
    mean = np.array([(weight * u).sum(), (weight * v).sum()])
    return mean, np.sqrt([(weight * (u - mean[0]) ** 2).sum(), (weight * (v - mean[1]) ** 2).sum()])


@needs_numpyro
@pytest.mark.slow
@pytest.mark.parametrize("wrong", [False, True])
def test_a_nearly_linear_case_has_the_known_posterior(tiny, exact, wrong, monkeypatch):
    """The negative control has the Jacobian of the unconstrained parameters with the wrong sign."""
    if wrong:
        real = no_u_turn._potential

        def mistaken(bound, near):
            potential, realised = real(bound, near)
            return (lambda place: potential(place) + 2.0 * place["u"].sum()), realised

        monkeypatch.setattr(no_u_turn, "_potential", mistaken)
    chains = NoUTurn(warm_up=200).run(tiny, RunOptions(draws=500, chains=2, seed=4, trajectories=3))
    z = (np.log(chains.theta) - exact[0]) / exact[1]
    error = np.array([mcse_of_mean(np.ascontiguousarray(z[..., k])) for k in range(2)])
    assert error.max() < 0.5 / SHARPNESS
    # The linearisation of readings of 12 rows is worth less than a twentieth of a standard deviation.
    off = (np.abs(z.mean(axis=(0, 1))) - 0.05) / error
    assert (off.max() > TOLERANCE) == wrong, off
    if not wrong:
        np.testing.assert_allclose(z.std(axis=(0, 1)), 1.0, rtol=0.15)
        assert chains.statistics["diverging"].mean() < 0.01
        assert [part.shape for part in chains.trajectories] == [(2, 4, 12, 3)]
        assert np.abs(chains.trajectories[0][..., :2] - tiny.logs[0].true_poses[:, :2]).max() < 0.5
        draw = chains.trajectory_draw[1]
        theta, path = chains.theta[0, draw], np.ascontiguousarray(chains.trajectories[0][0, 1])
        joint = tiny.log_prior(theta) + log_joint(tiny.tables(theta)[0], path)
        assert chains.log_joint[0, draw] == pytest.approx(joint, rel=1e-9)


@needs_numpyro
def test_a_run_is_a_function_of_its_seed_and_ends_in_time(tiny):
    method, options = NoUTurn(warm_up=20), RunOptions(draws=6, chains=1, seed=4, trajectories=2)
    first, again = method.run(tiny, options), method.run(tiny, options)
    np.testing.assert_array_equal(first.theta, again.theta)
    assert first.settings["method"] == "nuts"
    with pytest.raises(SamplingError, match="the time was over before the first draw"):
        method.run(tiny, replace(options, stopwatch=Stopwatch(0.0)))


def _refused(model, log, error=ModelError):
    with pytest.raises(error) as caught:
        NoUTurn().run(model.bind(log), RunOptions(draws=4, chains=2))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_not_smooth_is_refused_in_one_line(monkeypatch):
    walls = simulate_amigobot(20.0, seed=1)
    assert "landmarks alone, but got RangeNoise" in _refused(default_model(walls), walls)
    log = simulate_landmark_field(20, seed=1)
    plain = default_model(log)
    growing = RobotModel(GrowingIncrementNoise(), plain.sensors)
    assert "constant noise for method nuts, but got GrowingIncrementNoise" in _refused(growing, log)
    effects = RobotModel(sensors=plain.sensors, effects=(effect_named("odometry-turn-scale"),))
    assert "without effects for method nuts, but got odometry-turn-scale" in _refused(effects, log)
    strange = replace(plain, priors={"sigma_turn": stats.weibull_min(2.0, scale=0.05)})
    assert "priors out of" in _refused(strange, log)
    monkeypatch.setitem(__import__("sys").modules, "numpyro.infer", None)
    assert "pip install 'pmcl[nuts]'" in _refused(plain, log, SamplingError)


@needs_numpyro
@pytest.mark.long
def test_nuts_and_conditional_agree_on_the_landmark_field():
    """The independent judge: two samplers with nothing in common but the model, within their Monte Carlo errors."""
    log = simulate_landmark_field(400, seed=0)
    bound = default_model(log).bind(log)
    judge = NoUTurn(warm_up=400).run(bound, RunOptions(draws=1000, chains=4, seed=1, trajectories=4))
    ours = ParticleGibbs().run(bound, RunOptions(draws=2000, chains=4, seed=2, trajectories=4))
    for k, name in enumerate(bound.names):
        pair = [np.ascontiguousarray(each.theta[..., k]) for each in (judge, ours)]
        assert max(r_hat(draws) for draws in pair) < 1.02, name
        assert min(bulk_ess(draws) for draws in pair) > 300.0, name
        error = np.hypot(*(mcse_of_mean(draws) for draws in pair))
        sd = pair[1].std()
        assert error < 0.1 * sd, name
        assert abs(pair[0].mean() - pair[1].mean()) < TOLERANCE * error, name
        assert pair[0].std() / sd == pytest.approx(1.0, abs=0.15), name
