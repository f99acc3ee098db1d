"""``pmcl demo``: the whole way in one command, with nothing to prepare."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.application import on_interrupt
from pmcl.cli.options import output_folder, progress_option, seed_option, wants_progress
from pmcl.cli.report import print_verdict

__all__ = ["demo"]

_FILES = {
    "log": "demo_log.nc",
    "posterior": "demo_posterior.nc",
    "report": "demo_report.html",
    "picture": "demo_posterior.png",
}

# Enough for a thousand effective draws of every parameter, and short enough to wait for.
_DRAWS = 600


@click.command(short_help="Simulate a robot, calibrate it and write a report; needs no input.")
@click.option(
    "--output-dir",
    "folder",
    type=click.Path(path_type=Path),
    default=".",
    show_default=True,
    callback=output_folder,
    help="Where to write.",
)
@seed_option(default=9)
@progress_option()
@click.pass_context
def demo(ctx: click.Context, folder: Path, seed: int, no_progress: bool) -> None:
    """Simulate the paper's Amigobot, calibrate it, and write log, posterior, report and picture.

    Exit status as of 'pmcl calibrate'.
    """
    from pmcl.calibration.workflow import calibrate
    from pmcl.posterior.files import write_posterior
    from pmcl.reports.figures import plot_pair
    from pmcl.reports.posterior_report import write_report
    from pmcl.simulations.amigobot import simulate_amigobot
    from pmcl.whole_file import replacing

    paths = {kind: folder / name for kind, name in _FILES.items()}
    on_interrupt(ctx, f"of {', '.join(_FILES.values())} only those named above were written")
    log = simulate_amigobot(seed=seed, where="demo")
    log.write(paths["log"])
    click.echo(f"{paths['log']}: an Amigobot with eight sonars drove for {log.n_steps} s ({log.n_readings} readings)")
    data = calibrate(log, draws=_DRAWS, seed=seed, progress=wants_progress(no_progress))
    write_posterior(data, paths["posterior"])
    status = print_verdict(data)
    write_report(data, paths["report"])
    with replacing(paths["picture"]) as temporary:
        plot_pair(data).savefig(temporary, format="png", dpi=90)
    for kind in ("posterior", "report", "picture"):
        click.echo(f"{kind}: {paths[kind]}")
    ctx.exit(status)
