"""One page about a criticism: the verdict in a sentence, where it shows, what explains it, and what was tried."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace

from pmcl.criticism.result import Candidate, Criticism, Estimate
from pmcl.criticism.verdict import called, channels_of
from pmcl.reports.criticism_figures import label_of, plot_candidates, plot_channels, plot_gains, plot_map, plot_pit
from pmcl.reports.html import embedded, page, write_page
from pmcl.reports.posterior_report import Picture

__all__ = ["write_criticism_report"]


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
    text = page(
        "criticism.html.j2",
        title="What the model lacks",
        verdict=found.verdict,
        sentence=found.sentence,
        good=found.verdict != "unknown effect",
        effects=found.effects,
        unexplained=[(one, channels_of(one, found.log)) for one in found.unexplained],
        notes=found.notes,
        commands=commands if found.effects else (),
        number=_number,
        called=called,
        parameters=_parameters(found),
        gaps=_gaps(found),
        alarms=[(_stage(step.model), step.alarms) for step in found.steps],
        pictures=_pictures(found),
        steps=[(n + 1, step, _rejected(step.candidates)) for n, step in enumerate(found.steps)],
        label=label_of,
        settings=sorted(found.settings.items()),
    )
    write_page(text, path)


def _pictures(found: Criticism) -> list[Picture]:
    pictures = [
        Picture(
            "Where on the map",
            "The path, coloured by how badly readings were foreseen there. Dark stretches are where model and log "
            "disagree most.",
            embedded(plot_map(found)),
        ),
        Picture(
            "Which channel, and when",
            "Each line is a channel. Red: it read longer than foreseen, blue: shorter, in standard errors of each "
            "cell's mean. A line of one colour is a biased channel, a column a moment at which the pose was wrong.",
            embedded(plot_channels(found)),
        ),
        Picture(
            "Are predictions as uncertain as they should be?",
            "Distribution of the probability integral transforms, minus the uniform one. A slope up and down is a "
            "bias, an S a wrong spread; within the grey band nothing can be said.",
            embedded(plot_pit(found)),
        ),
    ]
    for number, step in enumerate(found.steps):
        if not step.candidates:
            continue
        of = f"model with {' and '.join(step.model)}" if step.model else "base model"
        pictures.append(
            Picture(
                f"Candidates: scores of the {of}",
                "How strongly the log asks for each effect, the model's own parameters projected out. Bars beyond the "
                "dotted line are remarkable; ranking decides only what is refitted.",
                embedded(plot_candidates(found, number)),
            )
        )
        if any(math.isfinite(one.log_score_gain) for one in step.candidates):
            pictures.append(
                Picture(
                    f"Candidates: gains over the {of}",
                    "What each refitted candidate is worth, with two standard errors. The fit part names the "
                    "effect, the held-out part decides whether it is accepted.",
                    embedded(plot_gains(found, number)),
                )
            )
    return pictures


def _rejected(candidates: tuple[Candidate, ...]) -> list[Candidate]:
    return [one for one in candidates if math.isfinite(one.log_score_gain) and not one.accepted]


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
