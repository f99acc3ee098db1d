"""The evidence that draws of a fit give is that of quadrature, and is refused where the draws cannot tell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate, stats

from pmcl.criticism.fitting.evidence import nested_evidence
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter

# mypy: disable-error-code="no-untyped-def"

FREE = np.array([True])


def effect(*priors, squared=False):
    """An effect with a strength of each prior."""
    parameters = tuple(Parameter(f"size_{k}", "1", prior) for k, prior in enumerate(priors))
    null, clear = (0.0,) * len(priors), (1.0,) * len(priors)
    return Effect("made", ".", parameters, null, lambda tables, *_: tables, typical={"clear": clear}, squared=squared)


def told(draws, one, free=FREE):
    """Evidence from draws of the effect's parameters, beside one of another parameter."""
    columns = np.column_stack([np.ones(len(draws)), draws])
    return nested_evidence(SimpleNamespace(draws=columns), one, free)


@pytest.mark.parametrize("deviation", [-1.8, 0.0, 1.0, 1.5])
def test_of_a_normal_likelihood(deviation, rng):
    prior, sd = stats.norm(scale=0.5), 0.1
    shrunk = 0.25 / (0.25 + sd**2)
    draws = deviation * sd * shrunk + sd * np.sqrt(shrunk) * rng.standard_normal(100_000)
    expected = stats.norm.logpdf(deviation * sd, scale=np.hypot(0.5, sd)) - stats.norm.logpdf(deviation * sd, scale=sd)
    found = told(draws, effect(prior))
    assert found.value == pytest.approx(expected, abs=0.03)
    # A short chain knows that it knows less, and is not further off than it says.
    values = [told(draws[k : k + 60], effect(prior)) for k in range(0, 30_000, 60)]
    assert None not in values
    errors = np.array([one.value for one in values]) - expected
    said = np.array([one.noise for one in values])
    assert np.sqrt(np.mean(errors**2)) < 1.3 * np.sqrt(np.mean(said**2))
    assert np.mean(said) > found.noise


@pytest.mark.parametrize("peak", [-2.0, 0.0, 1.0, 2.4])
def test_of_a_weight_that_cannot_be_negative(peak, rng):
    """The likelihood is a normal with its peak at or beside the bound, the prior a half normal far wider."""
    prior, sd = stats.halfnorm(scale=1.0), 0.05
    factor, _ = integrate.quad(
        lambda size: prior.pdf(size) * np.exp(-0.5 * (size / sd - peak) ** 2 + 0.5 * peak**2), 0.0, 1.0, points=[0.1]
    )
    draws = stats.truncnorm.rvs(-peak, np.inf, loc=peak * sd, scale=sd, size=100_000, random_state=rng)
    assert told(draws, effect(prior)).value == pytest.approx(np.log(factor), abs=0.1)


def test_of_an_added_noise_whose_square_counts(rng):
    """Steps of different lengths have noise of their own length besides; both noises are unknown, as in a model."""
    prior = stats.halfnorm(scale=0.3)
    sigma, size = np.linspace(0.03, 0.1, 71)[:, None], np.linspace(0.0, 0.6, 241)
    plain, square = [], []
    for true in (0.0, 0.08, 0.1, 0.12) * 4:
        length = np.abs(rng.normal(0.25, 0.12, 600))
        error = rng.normal(size=600) * np.hypot(0.06, true * length)
        variance = sigma[..., None] ** 2 + (size[:, None] * length) ** 2
        log_likelihood = -0.5 * (np.log(variance) + error**2 / variance).sum(axis=-1)
        likelihood = np.exp(log_likelihood - log_likelihood.max()).sum(axis=0)
        weighted = prior.pdf(size) * likelihood
        expected = np.log(integrate.trapezoid(weighted, size) / likelihood[0])
        cumulated = integrate.cumulative_trapezoid(weighted, size, initial=0.0)
        draws = np.interp(rng.uniform(size=4000), cumulated / cumulated[-1], size)
        for errors, squared in ((plain, False), (square, True)):
            found = told(draws, effect(prior, squared=squared))
            errors.append(np.nan if found is None else found.value - expected)
    square = np.array(square)
    assert np.isfinite(square).sum() >= 12
    assert np.nanmax(np.abs(square)) < 1.2
    assert np.sqrt(np.nanmean(square**2)) < 0.6
    # A normal of the size itself is further off, and tells less often.
    plain = np.array(plain)
    assert np.isnan(plain).sum() > np.isnan(square).sum()
    assert np.sqrt(np.nanmean(plain**2)) > 0.8


def test_of_two_strengths_together(rng):
    priors, covariance = (stats.norm(scale=0.5), stats.norm(scale=2.0)), np.array([[0.01, 0.006], [0.006, 0.04]])
    draws = rng.multivariate_normal([0.1, -0.2], covariance, 100_000)
    at_none = stats.multivariate_normal([0.1, -0.2], covariance).logpdf([0.0, 0.0])
    expected = sum(prior.logpdf(0.0) for prior in priors) - at_none
    assert told(draws, effect(*priors), np.array([True, True])).value == pytest.approx(expected, abs=0.05)


def test_draws_far_from_none_and_what_is_not_fitted_tell_nothing(rng):
    draws = 1.0 + 0.1 * rng.standard_normal(100)
    assert told(draws, effect(stats.norm(scale=0.5))) is None
    assert told(draws, effect(stats.halfnorm(scale=0.5))) is None
    assert nested_evidence(SimpleNamespace(draws=draws[:, None]), effect(stats.norm()), np.array([False])) is None
    # Without a density of the prior at none there is no ratio.
    assert told(0.1 + 0.1 * np.abs(draws - 1.0), effect(stats.gamma(3.0, scale=0.2))) is None
