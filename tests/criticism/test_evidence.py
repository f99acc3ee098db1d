"""Evidence of a model with and without an effect, against the exact one of a linear Gaussian model."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.kalman import linear_model, log_evidence
from oracles.random_walk_model import rail_log, rail_model
from scipy import special, stats

from pmcl.criticism.fitting import trials
from pmcl.criticism.fitting.quick_fit import Effort, quick_fit
from pmcl.criticism.fitting.trials import log_prior_and_volume, trial_of_base, try_effect
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter

# mypy: disable-error-code="no-untyped-def"

# Long enough, and with enough passes of the filter, that neither matters beside a tenth of a nat.
EXACT = Effort(50, (100, 200), 4000, 8, passes=100)
PRIOR = stats.norm(scale=0.3)


def push_scale(tables, values, log, where):
    """The cart goes farther than it was told, by this share."""
    motion = tables.motion
    return tables._replace(motion=motion._replace(control=motion.control * (1.0 + float(values[0]))))


EFFECT = Effect(
    "push-scale", "pushed farther than told", (Parameter("push_scale", "1", PRIOR),), (0.0,), push_scale,
    typical={"clear": (0.1,)}, carrier="motion",
)  # fmt: skip


def exact(bound, scales):
    """Log evidence by quadrature over both noises, and over the scale of the push."""
    q, r = np.linspace(0.2, 1.1, 46), np.linspace(0.1, 0.9, 41)
    grid_q, grid_r = np.meshgrid(q, r, indexing="ij")
    priors = [parameter.prior for parameter in bound.parameters[:2]]
    prior = priors[0].logpdf(grid_q) + priors[1].logpdf(grid_r)
    model = linear_model(bound.tables(bound.prior_mean())[0])
    cells = [np.log(q[1] - q[0]) + np.log(r[1] - r[0])]
    values = []
    for scale in scales:
        scaled = model._replace(control=model.control * (1.0 + scale))
        of_scale = PRIOR.logpdf(scale) if len(scales) > 1 else 0.0
        values.append(prior + log_evidence(scaled, grid_q, grid_r) + of_scale)
    if len(scales) > 1:
        cells.append(np.log(scales[1] - scales[0]))
    return float(special.logsumexp(values) + sum(cells))


@pytest.mark.parametrize(
    ("hidden", "least"),
    [pytest.param(0.0, -6.0, marks=pytest.mark.long), pytest.param(0.03, 2.5, marks=pytest.mark.slow)],
)
def test_evidence_is_that_of_the_kalman_filter(hidden, least, monkeypatch):
    monkeypatch.setattr(trials, "_PASSES_OF_CURRENT", EXACT.passes)
    log = rail_log(150, 4)
    dataset = log.dataset.copy(deep=True)
    dataset["odometry"].values[:, 0] /= 1.0 + hidden
    log = type(log)(dataset, "pushed")
    base = rail_model().bind(log)
    current = trial_of_base(quick_fit(base, 1, effort=EXACT), seed=2)
    trial = try_effect(current, EFFECT, 1.0, log, seed=3, effort=EXACT)
    expected = exact(base, np.linspace(-0.12, 0.12, 121)) - exact(base, [0.0])
    assert expected > least
    # Near no effect from the draws of its strength; by Laplace's method from the scores of both filters in any case.
    assert trial.nested == (hidden == 0.0)
    laplace = log_prior_and_volume(trial.fit) - log_prior_and_volume(current.fit)
    assert trial.gain.total + laplace == pytest.approx(expected, abs=0.1)
    if trial.nested:
        assert trial.evidence == pytest.approx(expected, abs=0.1)
    else:
        # What is told of a weak effect is less: its largest block of rows is bounded.
        assert trial.gain.bounded + laplace == pytest.approx(trial.evidence, abs=0.01)
        assert trial.evidence < expected
