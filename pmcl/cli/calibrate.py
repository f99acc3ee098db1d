"""``pmcl calibrate``: from logs to a posterior."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmcl import defaults
from pmcl.cli.application import on_interrupt
from pmcl.cli.options import (
    effects_option,
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


@click.command(short_help="Draw from the posterior of a robot's noise parameters.")
@click.argument("logs", metavar="LOG.nc...", nargs=-1, required=True)
@output_option("The posterior to write (NetCDF, ArviZ).", required=False)
@click.option(
    "--model",
    "model_file",
    metavar="FILE.toml",
    help="Model file (see --print-model); without it the paper's model with the sensors of the log.",
)
@click.option("--print-model", is_flag=True, help="Print the model as a model file that you can edit, and stop.")
@effects_option()
@click.option("--outliers", is_flag=True, help="Add to the model that a share of the readings are gross errors.")
@click.option(
    "--method",
    type=click.Choice(["particle-gibbs", "ensemble"]),
    default="particle-gibbs",
    show_default=True,
    help="particle-gibbs: the paper's sampler. ensemble: emcee's StretchMove, for comparison.",
)
@click.option(
    "--kernel",
    type=click.Choice(["conditional", "smoothing"]),
    help="conditional: the exact posterior, to know the robot's noise. smoothing: the paper's kernel, to "
    "tune a filter that runs with as many particles.  [default: conditional]",
)
@click.option(
    "--particles",
    type=click.IntRange(min=2),
    help="Particles of the filter.  [default: "
    + ", ".join(f"{count} for {name}" for name, count in defaults.CALIBRATION_PARTICLES.items())
    + "]",
)
@click.option("--draws", type=_COUNT, default=defaults.DRAWS, show_default=True, help="Draws of each chain.")
@click.option("--chains", type=_COUNT, default=defaults.CHAINS, show_default=True, help="Number of chains.")
@click.option(
    "--metropolis-steps",
    type=_COUNT,
    help=f"Updates of theta for each trajectory (the paper's m).  [default: {defaults.METROPOLIS_STEPS}]",
)
@click.option(
    "--data-rate",
    type=_COUNT,
    help="Rows that each sweep of burn-in includes (the paper's r).  [default: the rows of the log divided by "
    f"{defaults.DATA_RATE_PARTS}]",
)
@click.option(
    "--sweeps-per-draw",
    type=_COUNT,
    help=f"Sweeps from one stored draw to the next.  [default: {defaults.SWEEPS_PER_DRAW}]",
)
@click.option(
    "--burn-in-particles",
    type=click.IntRange(min=2),
    help=f"Particles during burn-in, while rows are being included.  [default: {defaults.BURN_IN_PARTICLES}]",
)
@click.option(
    "--transport/--no-transport",
    default=None,
    help="Move theta and path together, which makes the chains mix.  [default: on for conditional, off for smoothing]",
)
@seed_option()
@click.option(
    "--checkpoint",
    type=click.Path(path_type=Path),
    metavar="FILE.h5",
    callback=writable_file,
    help="Write the run here every few seconds, so that it can be resumed, and keep the file. Without this option the "
    "file is POSTERIOR.nc.checkpoint.h5 beside the output, removed when the posterior is written.",
)
@click.option("--resume", is_flag=True, help="Go on from the checkpoint of an interrupted run, if there is one.")
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
    """Draw from the posterior of a robot's noise parameters, given one or several logs of it.

    Ends with a check of the calibrated model on these logs. Exit status: 0 all is well, 3 the chains have not
    converged, 4 they have, but readings and model disagree. The posterior is written in each case.
    """
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

    file = checkpoint if checkpoint is not None else output.with_name(f"{output.name}.checkpoint.h5")
    begun = file.exists()
    to_go_on = f"what was sampled is in {file}: go on with the same command and --resume"
    try:
        data = sample(logs, model, checkpoint=file, resume=resume, progress=progress, **settings)
    except PmclError:
        # The same command would fail again, and what it left would only stand in the way of the next.
        if not begun:
            file.unlink(missing_ok=True)
        raise
    except KeyboardInterrupt:
        on_interrupt(ctx, to_go_on if file.exists() else "nothing was sampled yet")
        raise
    on_interrupt(ctx, to_go_on)
    write_posterior(data, output)
    on_interrupt(ctx, f"the posterior was written to {output}")
    # A file that the user named is kept: it can be looked at, and the same command with --resume reads it at once.
    if checkpoint is None:
        file.unlink(missing_ok=True)
    status = tell(data)
    click.echo(f"posterior: {output}")
    return status


def _model(path: str | None, log: RobotLog, outliers: bool) -> RobotModel:
    from pmcl.models.model_file import read_model
    from pmcl.models.robot_model import default_model

    return default_model(log, outliers=outliers) if path is None else read_model(path, log)
