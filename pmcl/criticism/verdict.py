"""The verdict, and one sentence that says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pmcl.criticism.alarms import Judgement
from pmcl.criticism.result import Estimate, FoundEffect, Step, Unexplained
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect

__all__ = [
    "EXPLAINED", "NOTHING", "UNKNOWN", "WORTH_A_FORMULA", "called", "channels_of", "sentence_of", "told", "verdict_of",
]  # fmt: skip

NOTHING, EXPLAINED, UNKNOWN = "no missing effect", "explained", "unknown effect"

# What nothing explains must be this improbable to count as an unknown effect: an alarm that a named effect confirms
# is worth more than one that nothing does, and the alarms are asked again after each effect that was added.
_ALONE, _REMAINS = 0.02, 0.01
# Alarms weaker than this count for nothing unless a known effect confirms them: no formula is sought.
WORTH_A_FORMULA = _ALONE


def called(effect: Effect | FoundEffect) -> str:
    """Return an effect's name with its place, e.g. "beam-bias (beam 2)"."""
    place = ", ".join(
        f"{key.removesuffix('s') if len(values) == 1 else key} {', '.join(f'{v:g}' for v in values)}"
        for key, values in effect.where.items()
    )
    return f"{effect.name} ({place})" if place else effect.name


def channels_of(one: Unexplained, log: RobotLog) -> str:
    """Return the beams or landmarks of a disagreement, landmarks by their names in the log; empty for all."""
    return _named(one.beams, "landmarks" if one.channel.startswith("landmark") else "beams", log)


def _named(numbers: Sequence[float], kind: str, log: RobotLog) -> str:
    """Return numbers as text, those of landmarks as their names where the log has names."""
    if kind == "landmarks" and "landmark" in log.dataset.coords:
        names = log.dataset["landmark"].values
        return ", ".join(str(names[int(k)]) for k in numbers)
    return ", ".join(f"{number:g}" for number in numbers)


def verdict_of(found: Sequence[FoundEffect], last: Judgement) -> str:
    """Return the verdict from what was accepted and what the final model still leaves unusual."""
    if last.raised and last.p_value <= (_REMAINS if found else _ALONE):
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
) -> str:
    """Return the verdict in one sentence for a robot engineer."""
    parts = []
    if found:
        names = "; ".join(told(effect, log) for effect in found)
        gain = steps[-1].gap.log_score_per_reading - steps[0].gap.log_score_per_reading
        parts.append(f"{names}; with that in the model the held-out score rises by {gain:.3g} nats per reading")
        changed = _greatest_change(before, after)
        if changed:
            parts.append(changed)
    if verdict == NOTHING:
        weak = f"; a weak alarm (p = {unexplained[0].p_value:.1e}) is confirmed by nothing" if unexplained else ""
        return f"No missing effect: nothing about this log is unusual under the model{weak}"
    if verdict == UNKNOWN:
        worst = unexplained[0]
        kind = "landmark" if worst.channel.startswith("landmark") else "beam"
        where = worst.channel if worst.channel in log.dataset else f"the score of {worst.channel}"
        if worst.beams:
            where += f" of {kind}{'s' if len(worst.beams) > 1 else ''} {channels_of(worst, log)}"
        depends = f", depending on {worst.covariate}" if worst.covariate else ""
        rest = "something more is" if found else "something is"
        parts.append(
            f"{rest} missing that no known effect explains: it shows in {where}{depends}, most in rows "
            f"{worst.time[0]} to {worst.time[1]} (p = {worst.p_value:.1e})"
        )
    text = "; ".join(parts)
    return text[:1].upper() + text[1:]


def told(effect: FoundEffect, log: RobotLog) -> str:
    """Say what was found, e.g. "beam 2 reads 0.0616 ± 0.0031 m too long (beam-bias)"."""
    twins = effect.not_distinguishable_from
    alike = f"; this log cannot tell it from {' or '.join(twins)}" if twins else ""
    if not effect.finding:
        numbers = ", ".join(f"{name} = {one:+}" for name, one in effect.parameters.items())
        return f"{called(effect)}: {effect.summary.rstrip('.')} ({numbers}{alike})"
    places = {kind: _named(values, kind, log) for kind, values in effect.where.items()}
    return f"{effect.finding.format(*effect.parameters.values(), **places)} ({effect.name}{alike})"


def _greatest_change(before: Mapping[str, Estimate], after: Mapping[str, Estimate]) -> str:
    """Say which parameter of the base model changed most, when it changed by more than its uncertainty."""
    changes = {
        name: abs(after[name].mean - one.mean) / max(one.sd, 1e-12) for name, one in before.items() if name in after
    }
    if not changes:
        return ""
    name = max(changes, key=lambda key: changes[key])
    if changes[name] < 2.0:
        return ""
    verb = "falls" if after[name].mean < before[name].mean else "rises"
    unit = "" if before[name].unit == "1" else f" {before[name].unit}"
    return f"{name} {verb} from {before[name].mean:.3g} to {after[name].mean:.3g}{unit}"
