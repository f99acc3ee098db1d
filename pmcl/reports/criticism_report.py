"""An HTML page about a criticism: the verdict, where it shows, which effects explain it, and what was tried."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace

from pmcl.criticism.findings.parts import Candidate, Estimate, Step, Unexplained
from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.findings.verdict import (
    as_percentage,
    channels_of,
    likeness_of,
    next_drive_of,
    window_of,
    with_place,
)
from pmcl.criticism.judging.alarms import Alarm
from pmcl.reports.criticism_figures import label_of, plot_candidates, plot_channels, plot_gains, plot_map, plot_pit
from pmcl.reports.html import Picture, page, picture, write_page

__all__ = ["write_criticism_report"]

# Column of the answer "yes" or "no" in the table of alarms.
_ALARM_COLUMN = 5


def write_criticism_report(
    criticism: Criticism, path: str | os.PathLike[str], commands: Sequence[tuple[str, str]] = ()
) -> None:
    """Write a self-contained HTML file about a criticism.

    Parameters
    ----------
    criticism : Criticism
        The result of :func:`pmcl.criticism.workflow.criticize`.
    path : path-like
        The file; an older file of that name is replaced only when the new one is complete.
    commands : sequence of (str, str), optional
        Next steps for the user: purposes, and the commands for them.

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    alarms = [(_stage(step.model), alarm) for step in criticism.steps for alarm in step.alarms]
    text = page(
        "criticism.html.j2",
        title=f"What the model of {criticism.log.dataset.attrs.get('robot') or 'the robot'} lacks",
        subject=_subject(criticism),
        verdict=criticism.verdict,
        sentence=criticism.sentence,
        good=criticism.verdict != "unknown effect",
        effects=criticism.effects,
        unexplained=[_unexplained_row(disagreement, criticism) for disagreement in criticism.unexplained],
        notes=criticism.notes,
        commands=commands if criticism.effects else (),
        number=_number,
        with_place=with_place,
        as_percentage=as_percentage,
        likeness_of=likeness_of,
        next_drive_of=next_drive_of,
        window_of=window_of,
        nothing=as_percentage(criticism.nothing_probability),
        parameters=_parameters(criticism),
        gaps=_gaps(criticism),
        held_out=_held_out_part(criticism),
        alarms=[_alarm_row(stage, alarm) for stage, alarm in alarms],
        raised=lambda row, column: column == _ALARM_COLUMN and alarms[row][1].raised,
        pictures=_pictures(criticism),
        rejected=[row for number, step in enumerate(criticism.steps) for row in _rejected_rows(number + 1, step)],
        settings=sorted(criticism.settings.items()),
    )
    write_page(text, path)


def _subject(criticism: Criticism) -> str:
    log = criticism.log
    length = f"{log.n_steps} rows over {log.times[-1] - log.times[0]:.0f} s, {log.n_readings} readings"
    return f"{log.where}; {length}." if log.where else f"{length}."


def _held_out_part(criticism: Criticism) -> str:
    if criticism.held_out is None:
        return (
            f"on the held-out part of the log, the rows from {criticism.split} on, by models that were fitted to the "
            "rows before"
        )
    return f"on another log, {criticism.held_out.where} ({criticism.held_out.n_steps} rows), which no fit has used"


def _unexplained_row(disagreement: Unexplained, criticism: Criticism) -> tuple[str, ...]:
    low, high = disagreement.interval
    interval = f"{_number(low)} to {_number(high)}" if disagreement.covariate else "-"
    return (
        disagreement.channel,
        channels_of(disagreement, criticism.log) or "all",
        disagreement.covariate or "-",
        disagreement.moment,
        interval,
        f"{disagreement.time[0]} to {disagreement.time[1]}",
        _number(disagreement.p_value),
    )


def _alarm_row(stage: str, alarm: Alarm) -> tuple[str, ...]:
    worst = f"{alarm.worst.kind} {alarm.worst.channel}" if alarm.worst.channel >= 0 else str(alarm.worst.kind)
    raised = "yes" if alarm.raised else "no"
    feature = f"{worst} {alarm.worst.covariate}".strip()
    return (stage, alarm.family, feature, _number(alarm.z), _number(alarm.p_value), raised)


def _rejected_rows(number: int, step: Step) -> list[tuple[str, ...]]:
    rejected = [
        candidate
        for candidate in step.candidates
        if math.isfinite(candidate.log_score_gain) and not candidate.accepted
    ]
    if not rejected:
        return [(str(number), step.decision, "-", "", "", "")]
    return [_rejected_row(number, step, candidate) for candidate in rejected]


def _rejected_row(number: int, step: Step, candidate: Candidate) -> tuple[str, ...]:
    return (
        str(number),
        step.decision,
        label_of(candidate),
        _number(candidate.z),
        f"{_number(candidate.log_score_gain)} ± {_number(candidate.log_score_gain_se)}",
        _number(candidate.evidence),
    )


def _pictures(criticism: Criticism) -> list[Picture]:
    if criticism.first is None:  # nothing was judged
        return []
    pictures = [
        picture(
            plot_map(criticism),
            "Where on the map",
            "The path, coloured by how badly readings were predicted there. Dark stretches are where model and log "
            "disagree most.",
        ),
        picture(
            plot_channels(criticism),
            "Which channel, and when",
            "Each line is a channel. Red: it read longer than predicted; blue: shorter, in standard errors of the mean "
            "of each cell. A line of one colour shows a biased channel; a column of one colour shows a time at which "
            "the pose was wrong.",
        ),
        picture(
            plot_pit(criticism),
            "Are predictions as uncertain as they should be?",
            "Distribution of the probability integral transforms, minus the uniform one. One arch shows a bias, an S "
            "shows a wrong spread; a curve within the grey band shows neither.",
        ),
    ]
    for number, step in enumerate(criticism.steps):
        if not step.candidates:
            continue
        of = f"model with {' and '.join(step.model)}" if step.model else "base model"
        pictures.append(
            picture(
                plot_candidates(criticism, number),
                f"Candidates: scores of the {of}",
                "How strongly the data point to each effect, after the model's own parameters have explained what they "
                "can. Bars beyond the dotted line are significant. The ranking decides only what is refitted first.",
            )
        )
        if any(math.isfinite(candidate.log_score_gain) for candidate in step.candidates):
            pictures.append(
                picture(
                    plot_gains(criticism, number),
                    f"Candidates: gains over the {of}",
                    "Gain of each refitted candidate in the log score of all rows, with two standard errors, and in "
                    "evidence, which is less: it pays for parameters that the rows have chosen. Evidence and prior "
                    "together give the probability of each explanation.",
                )
            )
    return pictures


def _parameters(criticism: Criticism) -> list[tuple[str, str, str, str]]:
    rows = []
    for name in dict.fromkeys([*criticism.before, *criticism.after]):
        unit = (criticism.after.get(name) or criticism.before[name]).unit
        before, after = _estimate(criticism.before.get(name)), _estimate(criticism.after.get(name))
        rows.append((name, "" if unit == "1" else unit, before, after))
    return rows


def _gaps(criticism: Criticism) -> list[tuple[str, str, str, str]]:
    return [
        (
            _stage(step.model),
            f"{step.gap.log_score_per_reading:.4f}",
            f"{step.gap.pit_distance:.4f}",
            f"{100.0 * step.gap.coverage_90:.1f} %",
        )
        for step in criticism.steps
        if not math.isnan(step.gap.log_score_per_reading)  # nothing was judged
    ]


def _stage(model: tuple[str, ...]) -> str:
    """Name a step by what was added last."""
    return f"+ {model[-1]}" if model else "base model"


def _estimate(estimate: Estimate | None) -> str:
    return "" if estimate is None else f"{replace(estimate, unit='1'):+}"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.1e}" if value != 0.0 and abs(value) < 1e-3 else f"{value:.4g}"
