"""``pmcl localize``: from a log and a posterior to where the robot was."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmcl import defaults
from pmcl.cli.options import effects_option, map_option, output_option, parameter_values, seed_option, writable_file
from pmcl.errors import ModelError, PosteriorError

if TYPE_CHECKING:
    from pmcl.localization.track import Track
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.robot_model import RobotModel
    from pmcl.posterior.compat import Posterior

__all__ = ["localize"]

_COUNT = click.IntRange(min=1)
_PARTICLES = click.IntRange(min=2)


@click.command(short_help="Tell where a robot was, with the parameters that a calibration found.")
@click.argument("log_file", metavar="LOG.nc")
@output_option("The track to write (NetCDF).")
@click.option("--posterior", "posterior_file", metavar="POSTERIOR.nc", help="What 'pmcl calibrate' wrote.")
@click.option(
    "--method",
    type=click.Choice(["mean", "map", "posterior", "prior"]),
    default="mean",
    show_default=True,
    help="Which theta to use. mean: the posterior mean. map: the draw of the greatest joint density. "
    "posterior: all draws. prior: the prior mean, which needs no posterior.",
)
@click.option(
    "--theta",
    metavar="NAME=VALUE",
    multiple=True,
    callback=parameter_values,
    help="Value of a parameter, used instead of what --method gives (may be repeated).",
)
@map_option()
@click.option(
    "--model",
    "model_file",
    metavar="FILE.toml",
    help="Model file; without it the model that the posterior was calibrated with.",
)
@effects_option()
@click.option(
    "--particles", type=_PARTICLES, default=defaults.LOCALIZATION_PARTICLES, show_default=True,
    help="Particles of the filter.",
)  # fmt: skip
@click.option(
    "--least-particles", type=_PARTICLES, help="Let the number of particles follow the spread of the belief, "
    "from this number up to --particles.  [default: always --particles]",
)
@click.option(
    "--start-particles", type=_PARTICLES, help="Particles while the place of the robot is unknown; they become fewer "
    "as its belief narrows, down to --particles.  [default: 50 for each square metre that it may be on]",
)
@click.option(
    "--draws",
    type=_COUNT,
    help=f"Draws of the posterior to work with (method posterior).  [default: {defaults.LOCALIZATION_DRAWS}]",
)
@click.option(
    "--draws-per-reading",
    type=_COUNT,
    help="Draws that the readings of each row are averaged over (method posterior).  [default: "
    f"{defaults.LOCALIZATION_DRAWS_PER_READING}]",
)
@click.option(
    "--start",
    type=click.Choice(["log", "anywhere"]),
    help="Where the robot may begin: where the log says, or anywhere on the map.  [default: as the model says]",
)
@click.option("--recover", is_flag=True, help="Look for the robot elsewhere when its readings become unlikely.")
@click.option(
    "--started-log",
    type=click.Path(path_type=Path),
    metavar="FILE",
    callback=writable_file,
    help="Write the log with the first pose that the whole track tells, where that was unknown (for 'pmcl calibrate').",
)
@seed_option()
@click.option(
    "--tum",
    type=click.Path(path_type=Path),
    metavar="FILE",
    callback=writable_file,
    help="Write the poses as TUM text too (for evo).",
)
@click.option(
    "--mcap",
    type=click.Path(path_type=Path),
    metavar="FILE",
    callback=writable_file,
    help="Write poses, map and the end points of readings as an MCAP file too (for Foxglove and rerun; needs "
    "pip install 'pmcl[ros]').",
)
@click.option(
    "--tum-reference",
    type=click.Path(path_type=Path),
    metavar="FILE",
    callback=writable_file,
    help="Write the log's reference trajectory as TUM text, to compare with.",
)
@click.pass_context
def localize(
    ctx: click.Context,
    /,
    log_file: str,
    output: Path,
    posterior_file: str | None,
    method: str,
    theta: dict[str, float],
    map_file: str | None,
    model_file: str | None,
    particles: int,
    start: str | None,
    seed: int,
    started_log: Path | None,
    tum: Path | None,
    mcap: Path | None,
    tum_reference: Path | None,
    **settings: Any,
) -> None:
    """Tell where a robot was at each row of its log, with the parameters that a calibration found."""
    outputs = [path for path in (output, started_log, tum, mcap, tum_reference) if path is not None]
    _protect(ctx, outputs, [path for path in (log_file, map_file, posterior_file, model_file) if path is not None])

    if mcap is not None:
        from pmcl.exports.mcap_track import require_mcap, write_mcap

        require_mcap()  # before the filter runs
    from pmcl.localization.offline import localize as run
    from pmcl.localization.options import FilterOptions
    from pmcl.localization.tum import write_tum
    from pmcl.logs.robot_log import RobotLog
    from pmcl.posterior.files import read_posterior

    log = RobotLog.read(log_file, map_file)
    if tum_reference is not None and log.true_poses is None:
        raise click.UsageError(f"--tum-reference: the log {log_file} has no reference trajectory: leave it out", ctx)
    posterior = None if posterior_file is None else read_posterior(posterior_file)
    model = _model(log, model_file, posterior, posterior_file, start)
    try:
        track = run(
            log, model, posterior, method, theta=theta, particles=particles, seed=seed,
            options=FilterOptions(**settings),
        )  # fmt: skip
    except PosteriorError as error:
        raise PosteriorError(f"{posterior_file}: {error}" if posterior_file else f"--posterior: {error}") from None
    track.write(output)
    if started_log is not None:
        from pmcl.localization.beginning import with_found_start

        started = with_found_start(log, track, model, posterior, method, theta=theta, particles=particles, seed=seed)
        started.write(started_log)
    if tum is not None:
        track.write_tum(tum)
    if mcap is not None:
        write_mcap(mcap, track, log)
    if tum_reference is not None and log.true_poses is not None:
        write_tum(tum_reference, log.times, log.true_poses)
    _print_summary(track)
    click.echo(f"track: {output}")
    if started_log is not None:
        (x, y, yaw), std = started.start_mean, started.start_std
        click.echo(
            f"log: {started_log}, begins at {x:.2f},{y:.2f},{yaw:.3f} [m, m, rad] with standard deviations "
            f"{std[0]:.2f} m, {std[1]:.2f} m, {std[2]:.2f} rad"
        )


def _model(
    log: RobotLog, model_file: str | None, posterior: Posterior | None, posterior_file: str | None, start: str | None
) -> RobotModel:
    """Return the model of a file, or the one whose parameters the posterior has."""
    import dataclasses

    from pmcl.localization.model_choice import model_for
    from pmcl.models.model_file import read_model
    from pmcl.models.starts.belief import StartBelief

    try:
        model = model_for(log, posterior) if model_file is None else read_model(model_file, log)
    except ModelError as error:
        of_posterior = model_file is None and posterior_file is not None
        raise ModelError(f"{posterior_file}: {error}" if of_posterior else str(error)) from None
    if start == "anywhere":
        unknown = (float("inf"),) * 3
        return dataclasses.replace(model, start=StartBelief(mean=(0.0, 0.0, 0.0), std=unknown))
    return dataclasses.replace(model, start=StartBelief()) if start == "log" else model


def _protect(ctx: click.Context, outputs: list[Path], inputs: list[str]) -> None:
    taken = {os.path.realpath(path) for path in inputs}
    for path in outputs:
        if os.path.realpath(path) in taken:
            raise click.UsageError(
                f"expected an output other than the inputs and the other outputs, but {path} is both: "
                "name another file",
                ctx,
            )
        taken.add(os.path.realpath(path))


def _print_summary(track: Track) -> None:
    """Print what the filter did, and its errors where the log has a reference."""
    import numpy as np

    rows = [("rows", f"{track.times.size}", "")]
    read = track.log_score != 0.0
    if read.any():
        rows.append(("log score per row with readings", f"{track.log_score[read].mean():.3f}", "nat"))
        rows.append(("effective sample size, median", f"{np.median(track.ess[read]):.0f}", ""))
    if track.position_rmse is not None and track.heading_rmse is not None and track.coverage_95 is not None:
        rows.append(("position error, RMSE", f"{track.position_rmse:.4f}", "m"))
        worst = float(np.nanmax(track.dataset["position_error"]))
        rows.append(("position error, greatest", f"{worst:.4f}", "m"))
        rows.append(("heading error, RMSE", f"{track.heading_rmse:.4f}", "rad"))
        rows.append(("truth inside the 95 % ellipse", f"{100.0 * track.coverage_95:.1f}", "%"))
    for name, value, unit in rows:
        click.echo(f"{name:<32} {value:>10} {unit}".rstrip())
