"""Heavy-tailed motion noise as a mixture of Gaussians: the moves that draw its precisions keep the exact law.

Parameters, path and readings are drawn from the model itself. Moves that leave the posterior unchanged then leave the
mean of every function of parameters and path as it is, and the change of each is compared draw by draw.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles.amigobot_model import amigobot_log, draw_readings, tight_model
from oracles.monte_carlo import TOLERANCE, assert_agrees, off_by
from scipy import stats
from scipy.special import digamma, polygamma

from pmcl.filtering.kernels.linear import draw_precisions
from pmcl.filtering.particle_filter import make_rng
from pmcl.geometry import compose
from pmcl.logs.joined import join_logs
from pmcl.models.effects.selection import effect_named
from pmcl.sampling import scale_mixture
from pmcl.sampling.scale_mixture import Precisions
from pmcl.sampling.schedule import Schedule
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Proposal, linearised_at, transport_moves

T = 6
# Readings so noisy that the path follows the motion.
THETA = np.array([0.05, 0.03, 0.06, 0.3])
# How far a function may be off, in its own standard deviations.
MATTERS = 0.2


def _model(*more):
    """The tight model with heavy-tailed noise and further effects, and its log."""
    log = amigobot_log(T, seed=2, n_beams=2)
    model = tight_model(THETA)
    effects = tuple(effect_named(name).instances(log)[0] for name in ("heavy-tailed-motion-noise", *more))
    return replace(model, effects=effects).bind(log)


def _draw_path(tables, rng):
    """Draw a path from start and motion with Student's t, steps that slip, and a turn rate that wanders."""
    motion, size = tables.motion, tables.start.mean.size
    path = np.empty((T, size))
    path[0] = rng.normal(tables.start.mean, tables.start.std)
    for t in range(1, T):
        mean = motion.mean[t].copy()
        if rng.random() < motion.extras.slip_weight:
            mean[:2] *= 1.0 - motion.extras.slip_share
        if size > 3:
            mean[2] += motion.extras.wander[t] * path[t - 1, 3]
            path[t, 3] = rng.normal(motion.extras.keep[t] * path[t - 1, 3], np.sqrt(1.0 - motion.extras.keep[t] ** 2))
        increment = mean + motion.std[t] * rng.standard_t(1.0 / motion.extras.tail, 3)
        path[t, :3] = compose(path[t - 1, :3], increment)
        path[t, 2] = path[t - 1, 2] + increment[2]
    return path


@pytest.mark.parametrize("more", [(), ("wheel-slip",), ("turn-noise-correlated",)])
def test_precisions_along_paths_of_the_model_are_gamma_distributed(more, rng):
    """Averaged over paths, precisions given the path have the law from which the noise was mixed."""
    bound, sfc = _model(*more), make_rng(int(rng.integers(2**62)))
    theta, names = bound.prior_mean(), list(bound.names)
    theta[names.index("heavy_tailed_motion_noise")] = 0.3
    if "wheel_slip_weight" in names:
        theta[[names.index("wheel_slip_weight"), names.index("wheel_slip_share")]] = 0.4, 0.9
    tables = bound.tables(theta)[0]
    found = []
    for _ in range(3000):
        precision, drawn = draw_precisions(tables, _draw_path(tables, rng), sfc)
        np.testing.assert_array_equal(drawn, np.arange(T) > 0)
        found.append(precision[1:])
    shape = 0.5 / 0.3
    assert_agrees(np.array(found), 1.0, matters=0.2)
    assert_agrees(np.log(found), digamma(shape) - np.log(shape), matters=0.2)
    assert_agrees(np.array(found) ** 2, 1.0 + 1.0 / shape, matters=0.8)


def test_motion_given_the_precisions_is_gaussian(rng):
    """Integrated over the precisions, its density is Student's t."""
    bound = _model()
    theta = bound.prior_mean()
    theta[-1] = tail = 0.4
    tables = bound.tables(theta)[0]
    draws = stats.gamma(0.5 / tail, scale=2.0 * tail).rvs((20000, T, 3), random_state=rng)
    given = [Precisions((np.log(each),), (np.arange(T) > 0,)).given([tables])[0].motion for each in draws[:3]]
    for motion, precision in zip(given, draws, strict=False):
        assert motion.extras.tail == 0.0
        np.testing.assert_allclose(motion.std, tables.motion.std / np.sqrt(precision))
    scale = 1.0 / np.sqrt(draws[:, 1, 0])
    assert_agrees(stats.norm.pdf(1.3, scale=scale), stats.t.pdf(1.3, 1.0 / tail), matters=0.02)


def test_a_path_may_be_shorter_than_its_log(rng):
    bound, sfc = _model(), make_rng(int(rng.integers(2**62)))
    theta = bound.prior_mean()
    theta[-1] = 0.3
    tables = bound.tables(theta)
    path = _draw_path(tables[0], rng)[:4]
    precisions = Precisions.drawn(tables, [path], sfc)
    np.testing.assert_array_equal(precisions.used[0], [False, True, True, True, False, False])
    assert precisions.given(tables)[0].motion.std.shape == (T, 3)
    assert not precisions.following(tables, tables)[0].logs[0][4:].any()


def test_where_joined_logs_meet_there_is_no_step(rng):
    logs = [amigobot_log(T, seed=seed, n_beams=2) for seed in (2, 3)]
    log, path = join_logs(logs), np.vstack([one.true_poses for one in logs])
    effects = effect_named("heavy-tailed-motion-noise").instances(log)
    bound = replace(tight_model(THETA), effects=effects).bind(log)
    theta = bound.prior_mean()
    theta[-1] = 0.3
    tables = bound.tables(theta)
    precisions = Precisions.drawn(tables, [path], make_rng(1))
    np.testing.assert_array_equal(np.flatnonzero(~precisions.used[0]), [0, T])
    given = precisions.given(tables)[0].motion
    assert given.motion.extras.tail == 0.0
    np.testing.assert_array_equal(given.motion.std[T], tables[0].motion.motion.std[T])


def test_density_and_map_of_the_precisions(rng):
    """The density is that of logarithms of gamma distributed precisions; the map keeps their place in it."""
    bound = _model()
    old, new = bound.prior_mean(), bound.prior_mean()
    old[-1], new[-1] = 0.4, 0.1
    old_tables, new_tables = bound.tables(old), bound.tables(new)
    used = np.arange(T) > 0
    log = np.where(used[:, None], stats.loggamma(1.25, loc=np.log(0.8)).rvs((T, 3), random_state=rng), 0.0)
    precisions = Precisions((log,), (used,))
    exact = stats.loggamma(1.25, loc=np.log(0.8)).logpdf(log[used]).sum()
    assert precisions.log_density(old_tables) == pytest.approx(exact)
    there, slope = precisions.following(old_tables, new_tables)
    back, other = there.following(new_tables, old_tables)
    np.testing.assert_allclose(back.logs[0], log)
    assert slope == pytest.approx(-other)
    assert slope == pytest.approx(3 * (T - 1) * 0.5 * np.log(polygamma(1, 5.0) / polygamma(1, 1.25)))
    assert Precisions().log_density(old_tables) == 0.0
    assert Precisions().given(old_tables) is old_tables


@pytest.mark.parametrize("tail", [0.4, 1e-3, 4.9e-5, 1e-8])
def test_the_density_keeps_its_digits_where_tails_are_light(tail):
    """Near a Gaussian the logarithms are nearly normal, with the variance of the inverse shape."""
    bound = _model()
    theta = bound.prior_mean()
    theta[-1], shape = tail, 0.5 / tail
    log = np.sqrt(1.0 / shape) * np.linspace(-2.0, 2.0, 3 * T).reshape(T, 3)
    found = Precisions((log,), (np.full(T, True),)).log_density(bound.tables(theta))
    if tail > 1e-5:
        assert found == pytest.approx(stats.loggamma(shape, loc=-np.log(shape)).logpdf(log).sum(), abs=1e-5)
    else:
        assert found == pytest.approx(stats.norm(scale=np.sqrt(1.0 / shape)).logpdf(log).sum(), abs=1e-2)


def test_no_precisions_are_possible_where_the_noise_is_gaussian():
    bound = _model()
    theta = bound.prior_mean()
    theta[-1] = 0.3
    heavy = bound.tables(theta)
    motion = heavy[0].motion
    gaussian = [heavy[0]._replace(motion=motion._replace(extras=motion.extras._replace(tail=0.0)))]
    precisions = Precisions((np.zeros((T, 3)),), (np.arange(T) > 0,))
    assert precisions.log_density(gaussian) == -np.inf
    assert precisions.following(heavy, gaussian)[1] == -np.inf


def _change(draws, seed, moves=6):
    """Draw parameters, path and readings, and return by how much moves change some functions of them."""
    bound = _model()
    rng, sfc, transform = np.random.default_rng(seed), make_rng(seed), Unconstrained(bound.parameters)
    theta = bound.prior_mean()
    theta[-1] = 0.3
    centre = transform.to_line(theta)
    proposal = Proposal(0.3 * np.eye(5), centre - 0.2, 0.4 * np.eye(5))
    reference = _draw_path(bound.tables(theta)[0], rng)
    transport = linearised_at(bound, theta, [reference], proposal, Schedule(block=3))
    assert transport.mixture
    geometry, reading = transport.geometries[0][0], bound.tables(theta)[0].sensors[0].reading
    times = np.repeat(np.arange(T), np.diff(geometry.first))
    found, rates = [], []
    for _ in range(draws):
        theta = bound.draw_prior(rng)
        tables = bound.tables(theta)
        path = _draw_path(tables[0], rng)
        draw_readings(tables[0], path, rng)
        geometry.reading[:] = reading[times, geometry.channel]
        made = transport_moves(bound, theta, tables, [path], transport, transform, moves, 1.0, sfc)
        rates.append([made.walk_acceptance_rate, made.jump_rate, made.redraw_rate])
        found.append([_functions(theta, path), _functions(made.theta, made.paths[0])])
    before, after = np.moveaxis(np.array(found), 1, 0)
    return (after - before) / before.std(axis=0), np.nanmean(rates, axis=0)


def _functions(theta, path):
    steps = np.log(np.abs(np.diff(path[:, 2]) - 0.06) + 1e-3)
    astray = np.log1p((np.diff(path[:, 2]) - 0.06) ** 2 / theta[2] ** 2)
    return np.array([*np.log(theta[:4]), theta[4], np.log(theta[4] + 0.01), steps.mean(), steps.max(),
                     np.log(theta[2]) * steps.mean(), astray.mean(), astray.max()])  # fmt: skip


def test_moves_with_precisions_keep_the_law():
    change, rates = _change(2500, 1)
    assert rates.min() > 0.05, rates
    assert_agrees(change, 0.0, matters=MATTERS)


@pytest.mark.slow
@pytest.mark.parametrize("defect", ["no slope", "no density", "precisions of a Gaussian"])
def test_mistakes_in_the_moves_are_noticed(defect, monkeypatch):
    if defect == "no slope":
        real = Precisions.following
        monkeypatch.setattr(Precisions, "following", lambda *given: (real(*given)[0], 0.0))
    elif defect == "no density":
        monkeypatch.setattr(Precisions, "log_density", lambda *given: 0.0)
    else:
        monkeypatch.setattr(
            scale_mixture, "draw_precisions", lambda *given: (np.ones((T, 3)), np.arange(T) > 0)
        )
    change, _ = _change(2500, 1)
    assert off_by(change, 0.0).max() > TOLERANCE
