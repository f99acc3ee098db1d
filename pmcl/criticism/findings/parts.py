"""What the critic found, piece by piece, as plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pmcl.criticism.fitting.held_out import Gap
from pmcl.criticism.fitting.next_drive import NextDrive
from pmcl.criticism.fitting.when import Acting
from pmcl.criticism.judging.alarms import Alarm

__all__ = ["Alternative", "Candidate", "Estimate", "FoundEffect", "Step", "Unexplained"]


@dataclass(frozen=True)
class Estimate:
    """Posterior mean and standard deviation of a parameter, with its unit.

    ``format`` gives text for people. The format ``+`` keeps the sign, ``%`` gives per cent, and ``left|right`` chooses
    a word by the sign.

    Attributes
    ----------
    mean, sd : float
        Posterior mean and standard deviation, in `unit`.
    unit : str
        The unit; "1" for none.
    """

    mean: float
    sd: float
    unit: str

    def __format__(self, spec: str) -> str:
        """Return the size, rounded by its standard deviation, or the word that `spec` has for its sign."""
        if "|" in spec:
            positive, negative = spec.split("|")
            return negative if self.mean < 0.0 else positive
        scale, unit = (100.0, "%") if spec == "%" else (1.0, "" if self.unit == "1" else self.unit)
        mean, sd = scale * (self.mean if spec == "+" else abs(self.mean)), scale * self.sd
        if not 0.0 < sd < math.inf:
            return f"{mean:.3g} {unit}".rstrip()
        digits = max(1 - math.floor(math.log10(sd)), 0)
        return f"{mean:.{digits}f} ± {sd:.{digits}f} {unit}".rstrip()


class Alternative(NamedTuple):
    """What else may explain the log.

    Attributes
    ----------
    name : str
        An effect; "unknown effect" for what no catalogue has, and "nothing".
    where : mapping
        Its place, as in :class:`FoundEffect`.
    probability : float
        Its posterior probability.
    """

    name: str
    where: Mapping[str, Any]
    probability: float


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was accepted.

    Attributes
    ----------
    name, summary : str
        As in the catalogue; a formula for an effect outside it.
    where : mapping
        The beams, landmarks or walls that have it, e.g. ``{"beams": [2]}``; empty for an effect of the whole robot.
    parameters : mapping of str to Estimate
        Its calibrated parameters.
    p_value : float
        P-value of its score before it was added, or of the score of an effect that this log cannot distinguish from it.
    log_score_gain, log_score_gain_se : float
        Gain on held-out data [nat] when it was added, and its standard error.
    not_distinguishable_from : tuple of str
        Effects that this log cannot distinguish from it.
    advice : tuple of str
        Motions that would distinguish them.
    finding : str
        The sentence about a log that has it, see :class:`~pmcl.models.effects.effect.Effect`; empty for a formula.
    chosen_on_all_rows : bool
        Whether the held-out rows helped to choose it, so that its gain there is too large on average. Its parameters
        are fitted without these rows in any case.
    probability : float
        Posterior probability of this name when it was added, see :mod:`pmcl.criticism.naming.probability`; NaN where it
        was not computed, because the data show the effect without a fit, or the filter followed with it only.
    alternatives : tuple of Alternative
        What has the rest of the probability, the most probable first.
    acting : Acting or None
        When it acts; None where it acts throughout the log. The model has it throughout all the same.
    while_acting : mapping of str to Estimate
        Its parameters while it acts, from the rows in which it does; empty where they are not known.
    record_next : NextDrive or None
        The drive that would tell it best from :attr:`not_distinguishable_from`, in the same order; None where these are
        none, or no drive can be simulated.
    """

    name: str
    summary: str
    where: Mapping[str, Any]
    parameters: Mapping[str, Estimate]
    p_value: float
    log_score_gain: float
    log_score_gain_se: float
    not_distinguishable_from: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    finding: str = ""
    chosen_on_all_rows: bool = True
    probability: float = math.nan
    alternatives: tuple[Alternative, ...] = ()
    acting: Acting | None = None
    while_acting: Mapping[str, Estimate] = field(default_factory=dict)
    record_next: NextDrive | None = None


@dataclass(frozen=True)
class Unexplained:
    """Where the final model still disagrees with the log.

    Attributes
    ----------
    channel : str
        Variable of the log, or the name of a score or of a statistic of the user's own; "pose" where the filter loses
        the robot.
    beams : tuple of int
        Beams or landmarks; empty for all.
    covariate, moment : str
        The covariate that the disagreement depends on, and whether readings are biased ("mean") or have another spread
        than predicted ("spread"); "statistic" for a statistic of the user's own.
    interval : tuple of float
        Values of the covariate, in its unit, between which the disagreement is worst.
    time : tuple of int
        First and last row of the interval of rows in which it is worst.
    p_value : float
        Probability of such an alarm when the model is right, all families of alarms considered (Holm 1979). It may be
        compared with the rate of false alarms directly; p-values of single families are in :attr:`Step.alarms`. NaN
        where the filter loses the robot.
    """

    channel: str
    beams: tuple[int, ...]
    covariate: str
    moment: str
    interval: tuple[float, float]
    time: tuple[int, int]
    p_value: float


@dataclass(frozen=True)
class Candidate:
    """An effect that was tried.

    Attributes
    ----------
    name, where
        As in :class:`FoundEffect`.
    z, score_p_value : float
        Its standardised score on the whole log, and the score's p-value.
    log_score_gain, log_score_gain_se : float
        Gain in the log score of all rows [nat] and its standard error; NaN for an effect that was scored but not
        refitted.
    evidence : float
        Gain in log evidence [nat]: the gain in log score, less what the priors lose.
    values : mapping of str to float
        Its fitted parameters; empty for an effect that was not refitted.
    accepted : bool
        Whether it was added to the model.
    """

    name: str
    where: Mapping[str, Any]
    z: float
    score_p_value: float
    log_score_gain: float
    log_score_gain_se: float
    evidence: float
    values: Mapping[str, float] = field(default_factory=dict)
    accepted: bool = False


@dataclass(frozen=True)
class Step:
    """One model of the loop, and the decision about it.

    Attributes
    ----------
    model : tuple of str
        Names of the effects that the model has.
    gap : Gap
        How well the model predicts held-out data.
    alarms : tuple of Alarm
        The tests of the log.
    candidates : tuple of Candidate
        Refitted candidates, then the best of those that were only scored.
    decision : str
        The decision, e.g. "add beam-bias".
    critical_z : float
        Bound that the greatest standardised score exceeds in 5 % of logs without a missing effect.
    """

    model: tuple[str, ...]
    gap: Gap
    alarms: tuple[Alarm, ...]
    candidates: tuple[Candidate, ...]
    decision: str
    critical_z: float
