"""One page about a criticism: the verdict in a sentence, where it shows, what explains it, and what was tried."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace

from pmcl.criticism.judging.alarms import Alarm
from pmcl.criticism.findings.result import Criticism, Estimate, Step, Unexplained
from pmcl.criticism.findings.verdict import called, channels_of
from pmcl.reports.criticism_figures import label_of, plot_candidates, plot_channels, plot_gains, plot_map, plot_pit
from pmcl.reports.html import Picture, page, picture, write_page

__all__ = ["write_criticism_report"]

# Position of the answer "yes" or "no" in the table of alarms.
_ALARM_COLUMN = 5


def write_criticism_report(
    found: Criticism, path: str | os.PathLike[str], commands: Sequence[tuple[str, str]] = ()
) -> None:
    """Write one self-contained HTML file about a criticism.

    Parameters
    ----------
    found : Criticism
        From :func:`pmcl.criticism.workflow.criticize`.
    path : path-like
        An older file of that name stays whole until the new one is complete.
    commands : sequence of (str, str), optional
        What to do next: purposes and the commands for them.

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    alarms = [(_stage(step.model), alarm) for step in found.steps for alarm in step.alarms]
    text = page(
        "criticism.html.j2",
        title=f"What the model of {found.log.dataset.attrs.get('robot') or 'the robot'} lacks",
        subject=_subject(found),
        verdict=found.verdict,
        sentence=found.sentence,
        good=found.verdict != "unknown effect",
        effects=found.effects,
        unexplained=[_unexplained_row(one, found) for one in found.unexplained],
        notes=found.notes,
        commands=commands if found.effects else (),
        number=_number,
        called=called,
        parameters=_parameters(found),
        gaps=_gaps(found),
        split=found.split,
        alarms=[_alarm_row(stage, alarm) for stage, alarm in alarms],
        raised=lambda row, column: column == _ALARM_COLUMN and alarms[row][1].raised,
        pictures=_pictures(found),
        rejected=[row for number, step in enumerate(found.steps) for row in _rejected_rows(number + 1, step)],
        settings=sorted(found.settings.items()),
    )
    write_page(text, path)


def _subject(found: Criticism) -> str:
    log = found.log
    length = f"{log.n_steps} rows over {log.times[-1] - log.times[0]:.0f} s, {log.n_readings} readings"
    return f"{log.where}; {length}." if log.where else f"{length}."


def _unexplained_row(one: Unexplained, found: Criticism) -> tuple[str, ...]:
    where = f"{_number(one.interval[0])} to {_number(one.interval[1])}" if one.covariate else "-"
    rows = f"{one.time[0]} to {one.time[1]}"
    channels = channels_of(one, found.log) or "all"
    return (one.channel, channels, one.covariate or "-", one.moment, where, rows, _number(one.p_value))


def _alarm_row(stage: str, alarm: Alarm) -> tuple[str, ...]:
    worst = f"{alarm.worst.kind} {alarm.worst.channel}" if alarm.worst.channel >= 0 else str(alarm.worst.kind)
    raised = "yes" if alarm.raised else "no"
    told = f"{worst} {alarm.worst.covariate}".strip()
    return (stage, alarm.family, told, _number(alarm.z), _number(alarm.p_value), raised)


def _rejected_rows(number: int, step: Step) -> list[tuple[str, ...]]:
    rejected = [one for one in step.candidates if math.isfinite(one.log_score_gain) and not one.accepted]
    if not rejected:
        return [(str(number), step.decision, "-", "", "", "")]
    return [
        (
            str(number),
            step.decision,
            label_of(one),
            _number(one.z),
            f"{_number(one.fit_gain)} ± {_number(one.fit_gain_se)}",
            f"{_number(one.log_score_gain)} ± {_number(one.log_score_gain_se)}",
        )
        for one in rejected
    ]


def _pictures(found: Criticism) -> list[Picture]:
    pictures = [
        picture(
            plot_map(found),
            "Where on the map",
            "The path, coloured by how badly readings were foreseen there. Dark stretches are where model and log "
            "disagree most.",
        ),
        picture(
            plot_channels(found),
            "Which channel, and when",
            "Each line is a channel. Red: it read longer than foreseen, blue: shorter, in standard errors of the mean "
            "of each cell. A line of one colour is a biased channel, a column a moment at which the pose was wrong.",
        ),
        picture(
            plot_pit(found),
            "Are predictions as uncertain as they should be?",
            "Distribution of the probability integral transforms, minus the even one. A slope up and down is a bias, "
            "an S a wrong spread; within the grey band nothing can be said.",
        ),
    ]
    for number, step in enumerate(found.steps):
        if not step.candidates:
            continue
        of = f"model with {' and '.join(step.model)}" if step.model else "base model"
        pictures.append(
            picture(
                plot_candidates(found, number),
                f"Candidates: scores of the {of}",
                "How strongly the log asks for each effect, after the model's own parameters have explained what they "
                "can. Bars beyond the dotted line are remarkable; the ranking decides only what is refitted.",
            )
        )
        if any(math.isfinite(one.log_score_gain) for one in step.candidates):
            pictures.append(
                picture(
                    plot_gains(found, number),
                    f"Candidates: gains over the {of}",
                    "What each refitted candidate is worth, with two standard errors. The fit part names the effect, "
                    "the held-out part decides whether it is accepted.",
                )
            )
    return pictures


def _parameters(found: Criticism) -> list[tuple[str, str, str, str]]:
    rows = []
    for name in dict.fromkeys([*found.before, *found.after]):
        unit = (found.after.get(name) or found.before[name]).unit
        told = [_estimate(estimates.get(name)) for estimates in (found.before, found.after)]
        rows.append((name, "" if unit == "1" else unit, told[0], told[1]))
    return rows


def _gaps(found: Criticism) -> list[tuple[str, str, str, str]]:
    return [
        (
            _stage(step.model),
            f"{step.gap.log_score_per_reading:.4f}",
            f"{step.gap.pit_distance:.4f}",
            f"{100.0 * step.gap.coverage_90:.1f} %",
        )
        for step in found.steps
    ]


def _stage(model: tuple[str, ...]) -> str:
    """Name a step by what was added last."""
    return f"+ {model[-1]}" if model else "base model"


def _estimate(one: Estimate | None) -> str:
    return "" if one is None else f"{replace(one, unit='1'):+}"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.1e}" if value != 0.0 and abs(value) < 1e-3 else f"{value:.4g}"
