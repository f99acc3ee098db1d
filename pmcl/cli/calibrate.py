"""``pmcl calibrate``: from logs to a posterior."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmcl.cli.application import on_interrupt
from pmcl.cli.options import (
    output_option,
    progress_option,
    protect_inputs,
    seed_option,
    wants_progress,
    writable_file,
)
from pmcl.cli.report import tell
from pmcl.errors import PmclError

if TYPE_CHECKING:
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.robot_model import RobotModel

__all__ = ["calibrate"]

# Settings that only particle Gibbs has.
_OF_PARTICLE_GIBBS = (
    "kernel", "metropolis_steps", "data_rate", "sweeps_per_draw", "burn_in_particles", "transport",
)  # fmt: skip
_COUNT = click.IntRange(min=1)


@click.command()
@click.argument("logs", metavar="LOG.nc...", nargs=-1, required=True)
@output_option("The posterior to write (NetCDF, ArviZ).", required=False)
@click.option(
    "--model", "model_file", metavar="FILE.toml", help="Model file; without it the paper's model, as the log allows."
)
@click.option("--print-model", is_flag=True, help="Print the model as a model file to start from, and stop.")
@click.option("--outliers", is_flag=True, help="Allow for gross errors among the readings.")
@click.option(
    "--method", type=click.Choice(["particle-gibbs", "ensemble"]), default="particle-gibbs", show_default=True
)
@click.option(
    "--kernel",
    type=click.Choice(["conditional", "smoothing"]),
    help="conditional (default): the exact posterior, to know the physics. smoothing: the paper's, to tune a filter of "
    "as many particles.",
)
@click.option(
    "--particles",
    type=click.IntRange(min=2),
    help="Particles; 25 for conditional, 500 for smoothing, 200 for ensemble.",
)
@click.option("--draws", type=_COUNT, default=1000, show_default=True, help="Draws per chain.")
@click.option("--chains", type=_COUNT, default=4, show_default=True, help="Chains.")
@click.option("--metropolis-steps", type=_COUNT, help="Updates of theta per trajectory (the paper's m); 5.")
@click.option(
    "--data-rate", type=_COUNT, help="Rows that each sweep of burn-in includes (the paper's r); a fiftieth of the log."
)
@click.option("--sweeps-per-draw", type=_COUNT, help="Sweeps between stored draws; 4.")
@click.option("--burn-in-particles", type=click.IntRange(min=2), help="Particles while data is being included; 1000.")
@click.option("--transport/--no-transport", default=None, help="Move theta and path together; on for conditional.")
@seed_option()
@click.option(
    "--checkpoint",
    type=click.Path(path_type=Path),
    metavar="FILE.h5",
    callback=writable_file,
    help="Write every draw here, so that a run can be resumed.",
)
@click.option(
    "--resume", is_flag=True, help="Go on from the checkpoint, by default POSTERIOR.checkpoint.h5 beside the output."
)
@progress_option()
@click.pass_context
def calibrate(
    ctx: click.Context,
    /,
    logs: tuple[str, ...],
    output: Path | None,
    model_file: str | None,
    print_model: bool,
    outliers: bool,
    checkpoint: Path | None,
    resume: bool,
    no_progress: bool,
    **settings: Any,
) -> None:
    """Draw from the posterior of a robot's noise parameters, given one or several logs of it."""
    if output is None and not print_model:
        raise click.UsageError("Missing option '-o' / '--output'", ctx)
    if model_file is not None and outliers:
        raise click.UsageError("--outliers says what a model file says itself: give one of the two", ctx)
    settings = {name: value for name, value in settings.items() if value is not None}
    foreign = [name for name in _OF_PARTICLE_GIBBS if name in settings]
    if settings["method"] == "ensemble" and foreign:
        raise click.UsageError(
            f"--{foreign[0].replace('_', '-')} belongs to the method particle-gibbs: leave it out", ctx
        )
    if output is not None:
        protect_inputs(ctx, output, (*logs, *([model_file] if model_file else [])))

    from pmcl.logs.robot_log import RobotLog

    read = [RobotLog.read(path) for path in logs]
    model = _model(model_file, read[0], outliers)
    if print_model:
        from pmcl.models.model_file import model_text

        click.echo(model_text(model, read[0]), nl=False)
        return
    assert output is not None
    if resume and checkpoint is None:
        checkpoint = output.with_name(f"{output.name}.checkpoint.h5")
    ctx.exit(_run(ctx, read, model, output, checkpoint, resume, settings, wants_progress(no_progress)))


def _run(
    ctx: click.Context,
    logs: list[RobotLog],
    model: RobotModel,
    output: Path,
    checkpoint: Path | None,
    resume: bool,
    settings: dict[str, Any],
    progress: bool,
) -> int:
    from pmcl.posterior.calibrate import calibrate as sample
    from pmcl.posterior.files import write_posterior

    begun = checkpoint is not None and checkpoint.exists()
    if checkpoint is not None:
        on_interrupt(ctx, f"go on with the same command and --resume --checkpoint {checkpoint}")
    try:
        data = sample(logs, model, checkpoint=checkpoint, resume=resume, progress=progress, **settings)
    except PmclError:
        # The same command would fail again, and what it left would only stand in the way of the next.
        if checkpoint is not None and not begun:
            checkpoint.unlink(missing_ok=True)
        raise
    write_posterior(data, output)
    status = tell(data)
    click.echo(f"posterior: {output}")
    return status


def _model(path: str | None, log: RobotLog, outliers: bool) -> RobotModel:
    from pmcl.models.model_file import read_model
    from pmcl.models.robot_model import default_model

    return default_model(log, outliers=outliers) if path is None else read_model(path, log)
