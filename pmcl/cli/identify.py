"""``pmcl identify``: which parameters a log can tell, before it is calibrated."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.options import effects_option, map_option, output_option, protect_inputs, seed_option

__all__ = ["identify"]


@click.command(short_help="Predict which parameters a log can tell, and what to drive to learn the rest.")
@click.argument("log", metavar="LOG.nc")
@output_option("The page to write (HTML, one file); without it, only lines on the terminal.", required=False)
@map_option()
@click.option("--model", "model_file", metavar="FILE.toml", help="Model file; without it the usual model of the log.")
@effects_option()
@click.option(
    "--drives/--no-drives",
    default=True,
    show_default=True,
    help="Simulate drives that might tell more, and advise the best.",
)
@seed_option()
@click.pass_context
def identify(
    ctx: click.Context,
    /,
    log: str,
    output: Path | None,
    map_file: str | None,
    model_file: str | None,
    drives: bool,
    seed: int,
) -> None:
    """Predict, in seconds, how well a calibration of a log will know each parameter of the model.

    For parameters that the log cannot tell, it says what to drive, and for how long.
    """
    if output is not None:
        protect_inputs(ctx, output, [log, *(path for path in (model_file, map_file) if path)])
    from pmcl.identifiability.workflow import identify as run
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.model_file import read_model
    from pmcl.reports.identification_report import identification_text, write_identification_report

    robot_log = RobotLog.read(log, map=map_file)
    model = read_model(model_file, robot_log) if model_file is not None else None
    found = run(robot_log, model, drives=drives, seed=seed)
    if output is not None:
        write_identification_report(found, output)
    click.echo(identification_text(found))
    if output is not None:
        click.echo(f"report: {output}")
