"""``pmcl calibrate``: from logs to a posterior."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmcl import defaults
from pmcl.cli.application import on_interrupt
from pmcl.cli.method_options import MethodCommand, chosen_method
from pmcl.cli.options import (
    effects_option,
    map_option,
    output_option,
    progress_option,
    protect_inputs,
    seed_option,
    wants_progress,
    writable_file,
)
from pmcl.cli.report import print_verdict
from pmcl.errors import ConversionError, PmclError

if TYPE_CHECKING:
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.robot_model import RobotModel

__all__ = ["calibrate"]

_COUNT = click.IntRange(min=1)


@click.command(cls=MethodCommand, short_help="Draw from the posterior of a robot's noise parameters.")
@click.argument("logs", metavar="LOG.nc...", nargs=-1, required=True)
@output_option("The posterior to write (NetCDF, ArviZ).", required=False)
@map_option()
@click.option(
    "--model",
    "model_file",
    metavar="FILE.toml",
    help="Model file (see --print-model); without it the paper's model with the sensors of the log.",
)
@click.option("--print-model", is_flag=True, help="Print the model as a model file that you can edit, and stop.")
@effects_option()
@click.option(
    "--tempering",
    type=click.Choice(["model", "held-out"]),
    default="model",
    show_default=True,
    help="Exponent of the readings of a lidar, whose beams err together. model: as the model file says, else the usual "
    "one for the number of beams. held-out: the one with which a filter best foresees the last two fifths of the log "
    "when it is calibrated on the rest; takes a minute or more.",
)
@click.option("--outliers", is_flag=True, help="Add to the model that a share of the readings are gross errors.")
@click.option("--draws", type=_COUNT, default=defaults.DRAWS, show_default=True, help="Draws of each chain.")
@click.option("--chains", type=_COUNT, default=defaults.CHAINS, show_default=True, help="Number of chains.")
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
    map_file: str | None,
    model_file: str | None,
    print_model: bool,
    tempering: str,
    outliers: bool,
    method: str,
    draws: int,
    chains: int,
    seed: int,
    checkpoint: Path | None,
    resume: bool,
    no_progress: bool,
    **method_settings: Any,
) -> None:
    """Draw from the posterior of a robot's noise parameters, given one or several logs of it.

    Ends with a check of the calibrated model on these logs. Exit status: 0 all is well, 3 the chains have not
    converged, 4 they have, but readings and model disagree. The posterior is written in each case.
    """
    if output is None and not print_model:
        raise click.UsageError("Missing option '-o' / '--output'", ctx)
    if model_file is not None and outliers:
        raise click.UsageError("--outliers is for the default model, which --model replaces: give one of the two", ctx)
    chosen = chosen_method(ctx, method, method_settings)
    if output is not None:
        inputs = [path for path in (*logs, map_file, model_file) if path]
        protect_inputs(ctx, output, inputs)
        if checkpoint is not None:
            protect_inputs(ctx, checkpoint, [*inputs, str(output)])

    from pmcl.logs.robot_log import RobotLog
    from pmcl.maps.occupancy_grid import OccupancyGrid

    grid = None if map_file is None else OccupancyGrid.read(map_file)
    robot_logs = [RobotLog.read(path, grid) for path in logs]
    model = _model(model_file, robot_logs[0], outliers)
    if tempering == "held-out":
        model = _tempered(model, robot_logs, seed)
    if print_model:
        from pmcl.models.model_file import model_text

        click.echo(model_text(model, robot_logs[0]), nl=False)
        return
    assert output is not None
    settings = {"method": chosen, "draws": draws, "chains": chains, "seed": seed, "resume": resume}
    settings["progress"] = wants_progress(no_progress)
    ctx.exit(_run(ctx, robot_logs, model, output, checkpoint, settings))


def _run(
    ctx: click.Context,
    logs: list[RobotLog],
    model: RobotModel,
    output: Path,
    checkpoint: Path | None,
    settings: dict[str, Any],
) -> int:
    """Calibrate, write the posterior and print what was found; return the exit status."""
    from pmcl.calibration.workflow import calibrate as run_calibration
    from pmcl.posterior.files import write_posterior

    file = checkpoint if checkpoint is not None else output.with_name(f"{output.name}.checkpoint.h5")
    existed = file.exists()
    to_go_on = f"what was sampled is in {file}: go on with the same command and --resume"
    try:
        data = run_calibration(logs, model, checkpoint=file, **settings)
    except ConversionError:
        raise
    except PmclError:
        # The same command would fail again, and its checkpoint would only be in the way of the next one.
        if not existed:
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
    status = print_verdict(data)
    click.echo(f"posterior: {output}")
    return status


def _tempered(model: RobotModel, logs: list[RobotLog], seed: int) -> RobotModel:
    """Return the model with the exponent that foresees held-out rows best, and print how well each does."""
    from pmcl.calibration.tempering import held_out_exponent, with_exponent

    found = held_out_exponent(logs, model, seed=seed, report=lambda line: click.echo(f"tempering: {line}", err=True))
    click.echo("exponent  held-out log score of a reading [nat]  behind the best", err=True)
    rows = zip(found.exponents, found.log_score, found.behind, found.behind_error, strict=True)
    for exponent, score, behind, error in rows:
        mark = "  <- chosen" if exponent == found.chosen else ""
        click.echo(f"{exponent:8.4f}  {score:37.4f}  {behind:6.4f} +- {error:.4f}{mark}", err=True)
    return with_exponent(model, found.chosen)


def _model(path: str | None, log: RobotLog, outliers: bool) -> RobotModel:
    from pmcl.models.model_file import read_model
    from pmcl.models.robot_model import default_model

    return default_model(log, outliers=outliers) if path is None else read_model(path, log)
