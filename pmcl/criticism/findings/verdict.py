"""The verdict, and the sentence that states it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from pmcl.criticism.findings.parts import Alternative, Estimate, FoundEffect, Step, Unexplained
from pmcl.criticism.fitting.when import Moment
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.scoring.statistics import OWN
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect

__all__ = [
    "EXPLAINED", "NOTHING", "UNKNOWN", "as_percentage", "channels_of", "finding_of", "likeness_of",
    "next_drive_of", "sentence_of", "size_throughout", "verdict_of", "window_of", "with_place",
]  # fmt: skip

NOTHING, EXPLAINED, UNKNOWN = "no missing effect", "explained", "unknown effect"

# A parameter of the base model is mentioned when it changes by at least this many of its standard deviations.
_CHANGED = 2.0
# Times whose interval is at least so long [s] are told in full seconds (chosen by hand).
_FULL_SECONDS = 2.0
# A drive is recommended where it tells more often than not.
_WORTH_A_DRIVE = 0.5
# More beams or landmarks than this are counted instead of listed in the sentence.
_MOST_LISTED = 8


def with_place(effect: Effect | FoundEffect | Alternative) -> str:
    """Return an effect's name with its place, e.g. "beam-bias (beam 2)"."""
    place = ", ".join(
        f"{key.removesuffix('s') if len(values) == 1 else key} {', '.join(f'{v:g}' for v in values)}"
        for key, values in effect.where.items()
    )
    return f"{effect.name} ({place})" if place else effect.name


def channels_of(unexplained: Unexplained, log: RobotLog) -> str:
    """Return the beams or landmarks of a disagreement as text.

    Parameters
    ----------
    unexplained : Unexplained
        The disagreement.
    log : RobotLog
        The log; its landmarks are named as in it.

    Returns
    -------
    str
        Empty for all channels.
    """
    return _as_text(unexplained.beams, "landmarks" if unexplained.channel.startswith("landmark") else "beams", log)


def _as_text(numbers: Sequence[float], kind: str, log: RobotLog) -> str:
    """Return numbers as text, those of landmarks as their names if the log has names."""
    if kind == "landmarks" and "landmark" in log.dataset.coords:
        names = log.dataset["landmark"].values
        return ", ".join(str(names[int(k)]) for k in numbers)
    return ", ".join(f"{number:g}" for number in numbers)


def verdict_of(found: Sequence[FoundEffect], last: Judgement, missing: float) -> str:
    """Return the verdict.

    Parameters
    ----------
    found : sequence of FoundEffect
        Accepted effects.
    last : Judgement
        Tests of the log under the final model.
    missing : float
        Probability that this model lacks something.

    Returns
    -------
    str
        :data:`NOTHING`, :data:`EXPLAINED` or :data:`UNKNOWN`. An alarm that no effect explains counts as an unknown
        effect if that is more probable than an alarm by chance.
    """
    if last.raised and missing > 0.5:
        return UNKNOWN
    return EXPLAINED if found else NOTHING


def sentence_of(
    verdict: str,
    found: Sequence[FoundEffect],
    unexplained: Sequence[Unexplained],
    steps: Sequence[Step],
    before: Mapping[str, Estimate],
    after: Mapping[str, Estimate],
    log: RobotLog,
    lost: str = "",
) -> str:
    """Return the verdict in one sentence for a robotics engineer.

    Parameters
    ----------
    verdict : str
        From :func:`verdict_of`.
    found : sequence of FoundEffect
        Accepted effects.
    unexplained : sequence of Unexplained
        Disagreements under the final model, the most significant first.
    steps : sequence of Step
        All models, from the base model to the final one.
    before, after : mapping of str to Estimate
        Parameters of the base model and of the final model.
    log : RobotLog
        The log.
    lost : str
        Where the filter of the base model loses the robot, if that is what remains unexplained.
    """
    parts = []
    if found:
        findings = "; ".join(finding_of(effect, log) for effect in found)
        gain = steps[-1].gap.log_score_per_reading - steps[0].gap.log_score_per_reading
        told = f"the held-out score {'rises' if gain >= 0.0 else 'falls'} by {abs(gain):.3g} nats per reading"
        if math.isnan(gain):  # a filter of either model loses the robot
            told = "the held-out score cannot be compared"
        parts.append(f"{findings}; with that in the model {told}")
        change = _greatest_change(before, after)
        if change:
            parts.append(change)
    if verdict == NOTHING:
        weak = f"; a weak alarm (p = {unexplained[0].p_value:.1e}) is confirmed by nothing" if unexplained else ""
        return f"No missing effect: nothing about this log is unusual under the model{weak}"
    subject = "something more is" if found else "something is"
    if verdict == UNKNOWN and lost:
        parts.append(f"{subject} missing that no known effect explains: {lost}")
    elif verdict == UNKNOWN:
        worst = unexplained[0]
        kind = "landmark" if worst.channel.startswith("landmark") else "beam"
        what = "the statistic" if worst.moment == OWN else "the score of"
        where = worst.channel if worst.channel in log.dataset else f"{what} {worst.channel}"
        if len(worst.beams) > _MOST_LISTED:
            where += f" of {len(worst.beams)} {kind}s"
        elif worst.beams:
            where += f" of {kind}{'s' if len(worst.beams) > 1 else ''} {channels_of(worst, log)}"
        depends = f", depending on {worst.covariate}" if worst.covariate else ""
        parts.append(
            f"{subject} missing that no known effect explains: it shows in {where}{depends}, most in rows "
            f"{worst.time[0]} to {worst.time[1]} (p = {worst.p_value:.1e})"
        )
    text = "; ".join(parts)
    return text[:1].upper() + text[1:]


def finding_of(effect: FoundEffect, log: RobotLog) -> str:
    """State what was found, e.g. "beam 2 reads 0.0616 ± 0.0031 m too long (beam-bias)".

    Parameters
    ----------
    effect : FoundEffect
        The accepted effect.
    log : RobotLog
        The log; its landmarks are named as in it.
    """
    alike = "".join(f"; {text}" for text in likeness_of(effect))
    probability = as_percentage(effect.probability)
    if probability:
        alike = f", probability {probability}{alike}"
    if size := size_throughout(effect):
        alike += f"; {size}"
    when = f" {window_of(effect)}" if effect.acting else ""
    if not effect.finding:
        numbers = ", ".join(f"{name} = {estimate:+}" for name, estimate in effect.parameters.items())
        return f"{with_place(effect)}: {effect.summary.rstrip('.')}{when} ({numbers}{alike})"
    places = {kind: _as_text(values, kind, log) for kind, values in effect.where.items()}
    parameters = effect.while_acting or effect.parameters
    return f"{effect.finding.format(*parameters.values(), **places)}{when} ({effect.name}{alike})"


def next_drive_of(effect: FoundEffect) -> tuple[str, ...]:
    """Say what to record next to learn which of the effects that a log cannot tell apart is right.

    Parameters
    ----------
    effect : FoundEffect
        The accepted effect.

    Returns
    -------
    tuple of str
        No, one or two clauses.
    """
    drive = effect.record_next
    if drive is None:
        return ()
    chances = dict(zip(effect.not_distinguishable_from, drive.probabilities, strict=True))
    told = [twin for twin, chance in chances.items() if chance > _WORTH_A_DRIVE]
    clauses = []
    if told:
        least = as_percentage(min(chances[twin] for twin in told))
        which = " and ".join(told)
        clauses.append(
            f"record {drive.seconds / 60.0:g} minutes of '{drive.name}' next, which tell it from {which} with a "
            f"probability of {least}"
        )
    if untold := [twin for twin in chances if twin not in told]:
        which = " or ".join(untold)
        clauses.append(f"no drive that was tried is likely to tell it from {which}")
    return tuple(clauses)


def window_of(effect: FoundEffect) -> str:
    """Say when an effect acts, e.g. "since t = 312 s (310 to 318 s)"; empty where it acts throughout the log."""
    acts = effect.acting
    if acts is None:
        return ""
    if acts.begin is None:
        return f"until {_moment(acts.end)}" if acts.end is not None else ""
    if acts.end is None:
        return f"since {_moment(acts.begin)}"
    return f"between {_moment(acts.begin)} and {_moment(acts.end)}"


def _moment(moment: Moment) -> str:
    """Return a time with its interval, in full seconds unless the interval is shorter than some of them."""
    width = moment.high - moment.low
    whole = width >= _FULL_SECONDS or all(time.is_integer() for time in moment)
    digits = 0 if whole else 1 if width >= 0.1 * _FULL_SECONDS else 2
    return f"t = {moment.time:.{digits}f} s ({moment.low:.{digits}f} to {moment.high:.{digits}f} s)"


def size_throughout(effect: FoundEffect) -> str:
    """Say what the model, which has an effect throughout, says of its size; empty where the effect acts throughout."""
    if not effect.while_acting:
        return ""
    sizes = ", ".join(f"{name} = {estimate:+}" for name, estimate in effect.parameters.items())
    return f"the model has it throughout the log, with {sizes}"


def likeness_of(effect: FoundEffect) -> tuple[str, ...]:
    """Say which effects the log cannot tell from one that was found, and which only look much alike.

    An effect that predicts nearly as well may still be improbable: a hundredth of a long log's gain is many nats.

    Parameters
    ----------
    effect : FoundEffect
        The accepted effect.

    Returns
    -------
    tuple of str
        No, one or two clauses.
    """
    possible = {with_place(other) for other in effect.alternatives}
    twins = effect.not_distinguishable_from
    unsure = [twin for twin in twins if math.isnan(effect.probability) or twin in possible]
    clauses = []
    if unsure:
        clauses.append(f"this log cannot tell it from {' or '.join(unsure)}")
    if alike := [twin for twin in twins if twin not in unsure]:
        clauses.append(f"{' and '.join(alike)} would look much alike")
    return tuple(clauses)


def as_percentage(probability: float) -> str:
    """Return a probability in per cent; nothing is called certain or impossible, and NaN gives an empty text."""
    if math.isnan(probability):
        return ""
    if probability > 0.99:
        return "above 99 %"
    return "below 1 %" if probability < 0.01 else f"{100.0 * probability:.0f} %"


def _greatest_change(before: Mapping[str, Estimate], after: Mapping[str, Estimate]) -> str:
    """Describe the base model's parameter that changed most, if it changed by more than its uncertainty."""
    changes = {
        name: abs(after[name].mean - estimate.mean) / max(estimate.sd, 1e-12)
        for name, estimate in before.items()
        if name in after
    }
    if not changes:
        return ""
    name = max(changes, key=lambda key: changes[key])
    if changes[name] < _CHANGED:
        return ""
    verb = "falls" if after[name].mean < before[name].mean else "rises"
    unit = "" if before[name].unit == "1" else f" {before[name].unit}"
    return f"{name} {verb} from {before[name].mean:.3g} to {after[name].mean:.3g}{unit}"
