"""Whether a model still needs gross errors among the readings, which were allowed for because its filter was lost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pmcl.criticism.fitting.quick_fit import Fit, quick_fit
from pmcl.criticism.fitting.trials import evidence_between, trial_of_base
from pmcl.criticism.naming.refits import Refits
from pmcl.errors import FilterError
from pmcl.filtering.ahead import compile_for_criticism
from pmcl.models.part import Part
from pmcl.streams import stream_seed

__all__ = ["Without", "without_gross_errors"]


class Without(NamedTuple):
    """The outcome of a fit without gross errors.

    Attributes
    ----------
    fit : Fit or None
        The fit; None where gross errors are still needed.
    reason : str
        Why they are still needed; empty where they are not.
    """

    fit: Fit | None
    reason: str = ""


def without_gross_errors(fit: Fit, sensors: Sequence[Part], refits: Refits, follow: Callable[[Fit], None]) -> Without:
    """Fit a model without gross errors, if its filter follows then and the log does not speak for them.

    Parameters
    ----------
    fit : Fit
        A fit of the model with gross errors.
    sensors : sequence of Part
        Its sensors without them.
    refits : Refits
        Refits models.
    follow : callable
        ``follow(fit)`` raises FilterError when the filter of a fitted model does not follow the robot.
    """
    settings = refits.settings
    settings.tell("is the filter still lost without gross errors?")
    bound, known = replace(fit.bound.model, sensors=tuple(sensors)).bind(refits.log), fit.values()
    theta = np.array([known[name] for name in bound.names])
    try:
        compile_for_criticism(bound.tables(theta)[0])
        plain = quick_fit(bound, stream_seed(settings.seed, "fit without gross errors"), theta=theta, path=fit.path)
        follow(plain)
        current, without = (trial_of_base(one, seed=refits.seed) for one in (fit, plain))
    except FilterError:
        return Without(None, "without them the filter loses the robot")
    evidence = evidence_between(current, without)
    return Without(plain) if evidence <= 0.0 else Without(None, f"the log speaks for them with {evidence:.1f} nats")
