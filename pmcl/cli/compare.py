"""``pmcl compare``: which method finds the posterior of a log soonest."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl import defaults
from pmcl.cli.application import NOT_CONVERGED
from pmcl.cli.options import (
    effects_option,
    map_option,
    output_option,
    progress_option,
    protect_inputs,
    seed_option,
    wants_progress,
)

__all__ = ["compare"]


@click.command(short_help="Compare methods of calibration on one log, for the same time each.")
@click.argument("log", metavar="LOG.nc")
@click.option(
    "--methods",
    default="conditional,smoothing,ensemble",
    show_default=True,
    metavar="NAME[:N],...",
    help="Methods of 'pmcl calibrate', each with a number of particles if you like: particle-gibbs:25 (or "
    "conditional:25), plain:25 (the same without transport moves), smoothing:500, ensemble:200, correlated-pmmh, ekf.",
)
@output_option("The page to write (HTML, one file).")
@click.option(
    "--seconds",
    type=click.FloatRange(min=0.0, min_open=True),
    default=60.0,
    show_default=True,
    help="Time of each method by the clock, burn-in included; the reference run takes twice as long.",
)
@click.option(
    "--chains", type=click.IntRange(min=2), default=defaults.CHAINS, show_default=True,
    help="Number of chains.",
)  # fmt: skip
@click.option(
    "--held-out",
    type=click.FloatRange(0.0, 0.5),
    default=0.25,
    show_default=True,
    metavar="SHARE",
    help="Share of the log, at its end, that no method sees, and on which a filter with the mean of each is scored: "
    "log score, and position error where the log has true poses. 0 holds nothing out.",
)
@map_option()
@click.option("--model", "model_file", metavar="FILE.toml", help="Model file; without it the paper's model.")
@effects_option()
@seed_option()
@progress_option()
@click.pass_context
def compare(
    ctx: click.Context,
    /,
    log: str,
    methods: str,
    output: Path,
    seconds: float,
    chains: int,
    held_out: float,
    map_file: str | None,
    model_file: str | None,
    seed: int,
    no_progress: bool,
) -> None:
    """Compare methods of calibration on one log: R-hat, effective draws and error against time.

    Exit status 3 when the reference run has not converged; the page is written all the same.
    """
    protect_inputs(ctx, output, [path for path in (log, map_file, model_file) if path])
    from pmcl.comparison.methods import parse_methods

    compared = parse_methods(methods)
    from pmcl.comparison.compare import compare as run
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.model_file import read_model
    from pmcl.reports.comparison_report import comparison_text, comparison_verdict, write_comparison

    robot_log = RobotLog.read(log, map_file)
    model = read_model(model_file, robot_log) if model_file else None
    comparison = run(
        robot_log, compared, model, seconds=seconds, chains=chains, seed=seed, held_out=held_out,
        progress=wants_progress(no_progress),
    )  # fmt: skip
    write_comparison(comparison, output)
    judged = comparison_verdict(comparison)
    click.echo(comparison_text(comparison))
    click.echo()
    for line in (judged.message, *judged.advice):
        click.echo(line)
    click.echo(f"report: {output}")
    ctx.exit(0 if judged.converged else NOT_CONVERGED)
