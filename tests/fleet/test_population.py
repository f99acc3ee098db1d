"""Mean and spread of a fleet against known answers: a conjugate model, a joint model, and simulated fleets."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from synthetic import LINE, fleet_of, measured, posterior_draws

from pmcl.fleet.densities import Line, RobotDensity, robot_density
from pmcl.fleet.population import population_of
from pmcl.models.parameters import Parameter

QUANTILES = (0.05, 0.5, 0.95)


def _direct(seen, noise, line):
    """Quantiles of mu and tau from the Gaussian marginal likelihood, on a fine grid of its own."""
    mu = np.linspace(seen.min() - 1.5, seen.max() + 1.5, 601)
    tau = np.linspace(1e-3, 3.0, 900)
    variance = tau[None, :, None] ** 2 + noise**2
    log_density = -0.5 * (np.log(variance) + (seen - mu[:, None, None]) ** 2 / variance).sum(axis=2)
    log_density += -0.5 * ((mu[:, None] - line.prior_mean) / (2.0 * line.prior_sd)) ** 2
    log_density += -0.5 * (tau / line.prior_sd) ** 2
    share = np.exp(log_density - log_density.max())
    share /= share.sum()
    found = [
        np.interp(QUANTILES, np.cumsum(share.sum(axis=other)), axis + 0.5 * (axis[1] - axis[0]))
        for other, axis in ((1, mu), (0, tau))
    ]
    return np.array(found)


@pytest.mark.parametrize("spread", [0.0, 0.3])
def test_mean_and_spread_of_a_conjugate_model_are_those_of_its_closed_form(rng, spread):
    """Stage two sees draws under a gamma prior only; the closed form never had a prior for single robots."""
    seen = measured(rng, np.log(0.08) + spread * rng.normal(size=8), 0.15)
    robots = [robot_density(posterior_draws(rng, one, 0.15, draws=20000), LINE) for one in seen]
    found = population_of(robots, LINE, oddness=0.0)
    mu, tau = _direct(seen, 0.15, LINE)
    sd_mu, sd_tau = (np.ptp(one) / 3.29 for one in (mu, tau))
    np.testing.assert_allclose(np.log(found.mean_quantiles(QUANTILES)), mu, atol=0.15 * sd_mu)
    np.testing.assert_allclose(found.spread_quantiles(QUANTILES), tau, atol=0.15 * sd_tau)


def test_forgetting_to_take_the_prior_out_is_seen(rng):
    """The negative control: with a prior far from the robots, posteriors used as likelihoods are far off."""
    line = Line(Parameter("sigma", "m", stats.lognorm(0.5, scale=0.04)))
    seen = measured(rng, np.full(8, np.log(0.08)), 0.3)
    draws = [posterior_draws(rng, one, 0.3, line, 20000) for one in seen]
    right = [robot_density(one, line) for one in draws]
    wrong = [RobotDensity(one.nodes, one.step, one.posterior, one.posterior) for one in right]
    mu, _ = _direct(seen, 0.3, line)
    error = [
        abs(np.log(population_of(robots, line, oddness=0.0).mean_quantiles((0.5,))[0]) - mu[1])
        for robots in (wrong, right)
    ]
    sd = np.ptp(mu) / 3.29
    assert error[0] > 1.3 * sd
    assert error[1] < 0.4 * sd


def test_two_stages_give_what_the_joint_model_gives(rng):
    """Six robots with few residuals each, whose likelihoods are skew, and all eight unknowns in one chain."""
    residuals = [np.exp(np.log(0.08) + 0.3 * rng.normal()) * rng.normal(size=9) for _ in range(6)]
    n, squares = 9, np.array([float(one @ one) for one in residuals])

    def log_likelihood(u, s):
        return -n * u - 0.5 * s * np.exp(-2.0 * u)

    grid = np.linspace(-6.0, 2.0, 4001)
    densities = []
    for s in squares:
        log_density = LINE.log_prior(grid) + log_likelihood(grid, s)
        below = np.cumsum(np.exp(log_density - log_density.max()))
        u = np.interp(rng.random(20000), below / below[-1], grid)
        densities.append(robot_density(np.exp(u), LINE))
    found = population_of(densities, LINE, oddness=0.0)

    # Metropolis on many copies at once, in turn for the population and for the robots.
    copies, sweeps = 400, 1500
    mu, log_tau = np.full(copies, -2.5), np.full(copies, -1.2)
    u = np.tile(0.5 * np.log(squares / n), (copies, 1))
    kept = []
    for sweep in range(sweeps):
        for scale in (0.15, 0.5):
            new = mu + scale * rng.normal(size=copies), log_tau + 2 * scale * rng.normal(size=copies)
            take = np.log(rng.random(copies)) < _log_population(*new, u) - _log_population(mu, log_tau, u)
            mu, log_tau = np.where(take, new[0], mu), np.where(take, new[1], log_tau)
        moved = u + 0.25 * rng.normal(size=u.shape)
        ratio = log_likelihood(moved, squares) - log_likelihood(u, squares)
        tau = np.exp(log_tau)[:, None]
        ratio += 0.5 * (((u - mu[:, None]) / tau) ** 2 - ((moved - mu[:, None]) / tau) ** 2)
        u = np.where(np.log(rng.random(u.shape)) < ratio, moved, u)
        if sweep >= sweeps // 3 and sweep % 10 == 0:
            kept.append((mu, np.exp(log_tau), u[:, 0]))
    mus, taus, firsts = (np.concatenate(part) for part in zip(*kept, strict=True))
    for exact, quantiles in ((np.exp(mus), found.mean_quantiles(QUANTILES)), (taus, found.spread_quantiles(QUANTILES))):
        np.testing.assert_allclose(quantiles, np.quantile(exact, QUANTILES), atol=0.12 * exact.std())
    mean, sd = found.robot_with_fleet(0)
    assert mean == pytest.approx(np.exp(firsts).mean(), abs=0.12 * np.exp(firsts).std())
    assert sd == pytest.approx(np.exp(firsts).std(), rel=0.12)


def _log_population(mu, log_tau, u):
    """Log density of mean and spread given the robots, but for a constant, with the Jacobian of the logarithm."""
    tau = np.exp(log_tau)
    value = -0.5 * ((mu - LINE.prior_mean) / (2.0 * LINE.prior_sd)) ** 2 - 0.5 * (tau / LINE.prior_sd) ** 2 + log_tau
    return value - (log_tau[:, None] + 0.5 * ((u - mu[:, None]) / tau[:, None]) ** 2).sum(axis=1)


def test_a_robot_far_off_does_not_widen_the_spread(rng):
    draws = fleet_of(rng, 0.08, 0.05, 0.03, robots=10, odd={0: 1.2})
    robots = [robot_density(one, LINE) for one in draws.values()]
    robust = population_of(robots, LINE).spread_quantiles((0.5,))[0]
    naive = population_of(robots, LINE, oddness=0.0).spread_quantiles((0.5,))[0]
    others = population_of(robots[1:], LINE).spread_quantiles((0.5,))[0]
    assert robust == pytest.approx(others, rel=0.15)
    assert naive > 3.0 * robust
    assert population_of(robots, LINE).odd_probability(0) > 0.99


def test_a_robot_of_few_readings_borrows_from_the_others(rng):
    draws = fleet_of(rng, 0.08, 0.05, 0.03, robots=10)
    draws["robot0"] = posterior_draws(rng, np.log(0.12), 0.6)
    found = population_of([robot_density(one, LINE) for one in draws.values()], LINE)
    mean, sd = found.robot_with_fleet(0)
    assert sd < 0.4 * draws["robot0"].std()
    assert abs(mean - 0.08) < 0.02
    mean, sd = found.robot_with_fleet(1)
    assert mean == pytest.approx(draws["robot1"].mean(), abs=2.0 * draws["robot1"].std())


def test_a_parameter_of_either_sign_is_compared_as_it_is():
    line = Line(Parameter("bias", "m", stats.norm(0.0, 0.1)))
    assert not line.ratio
    assert LINE.ratio
    assert line.prior_sd == pytest.approx(0.1, rel=0.01)
    np.testing.assert_allclose(line.from_line(line.to_line(np.array([-0.2, 0.3]))), [-0.2, 0.3])
    share = Line(Parameter("weight", "1", stats.beta(2, 30), role="weight"))
    np.testing.assert_allclose(share.from_line(share.to_line(np.array([0.01, 0.9]))), [0.01, 0.9])
    # The density on the line integrates to one: the Jacobian is in it.
    for each in (line, share, LINE):
        u = np.linspace(each.prior_mean - 12 * each.prior_sd, each.prior_mean + 12 * each.prior_sd, 4001)
        assert np.trapezoid(np.exp(each.log_prior(u)), u) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.long
def test_population_intervals_of_a_hundred_fleets_cover(rng):
    """90 % intervals of the typical robot, of the spread, and of a further robot."""
    covered = []
    for _ in range(100):
        typical, spread, noise = 0.05 + 0.1 * rng.random(), 0.1 + 0.2 * rng.random(), 0.05 + 0.1 * rng.random()
        robots = [robot_density(one, LINE) for one in fleet_of(rng, typical, spread, noise).values()]
        found = population_of(robots, LINE)
        low, high = found.mean_quantiles((0.05, 0.95))
        least, most = found.spread_quantiles((0.05, 0.95))
        below, above = found.new_robot_quantiles((0.05, 0.95))
        held = float(np.diff(stats.norm.cdf(np.log([below, above]), np.log(typical), spread))[0])
        covered.append((low < typical < high, least < spread < most, held))
    share = np.mean(covered, axis=0)
    assert np.all((share >= 0.85) & (share <= 0.95)), share
