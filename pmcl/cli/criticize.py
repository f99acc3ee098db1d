"""``pmcl criticize``: what the model of a log lacks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pmcl import defaults
from pmcl.cli.options import effects_option, output_option, progress_option, seed_option, wants_progress, writable_file

__all__ = ["criticize"]


@click.command(short_help="Find what the model of a log lacks, and name it.")
@click.argument("log", metavar="LOG.nc")
@output_option("The page to write (HTML, one file).")
@click.option(
    "--json",
    "json_file",
    type=click.Path(path_type=Path),
    metavar="FILE.json",
    callback=writable_file,
    help="Write the result for other programs, too.",
)
@click.option(
    "--model",
    "model_file",
    metavar="FILE.toml",
    help="Model file of the model to criticise; without it the paper's model.",
)
@effects_option()
@click.option(
    "--particles", type=click.IntRange(min=50), default=defaults.CRITICISM_PARTICLES, show_default=True,
    help="Particles of the filter passes that score effects.",
)
@click.option(
    "--level", type=click.FloatRange(0.0, 0.5, min_open=True, max_open=True), default=defaults.FALSE_ALARM_LEVEL,
    show_default=True, help="Share of faultless logs that may raise an alarm.",
)  # fmt: skip
@click.option("--joint/--no-joint", default=True, show_default=True,
    help="Calibrate the final model with full chains, or with one longer chain (faster).",)
@seed_option()
@progress_option()
def criticize(
    log: str, output: Path, json_file: Path | None, model_file: str | None, no_progress: bool, **settings: Any
) -> None:
    """Find where model and log disagree, name the missing effect, add it, and show the gap shrink."""
    from pmcl.criticism.workflow import criticize as run
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.model_file import read_model
    from pmcl.reports.criticism_report import write_criticism_report

    for file in (output, json_file):
        if file is not None and file.resolve() == Path(log).resolve():
            raise click.UsageError(f"expected an output other than the input, but both are {log}: name another file")
    read = RobotLog.read(log)
    model = read_model(model_file, read) if model_file is not None else None
    found = run(read, model, progress=wants_progress(no_progress), **settings)
    write_criticism_report(found, output)
    if json_file is not None:
        found.write(json_file)
    click.echo(f"{found.verdict}: {found.sentence}.")
    click.echo(f"report: {output}")
