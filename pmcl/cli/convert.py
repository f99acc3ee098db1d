"""``pmcl convert``: recordings as robot logs. Commands for lidars are in :mod:`pmcl.cli.convert_lidars`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pmcl.cli.options import output_option

if TYPE_CHECKING:
    from pmcl.logs.robot_log import RobotLog

__all__ = ["convert", "write_log"]

Command = TypeVar("Command", bound=Callable[..., Any])


@click.group(short_help="Convert a recording to a robot log: bags, texts, published data.")
def convert() -> None:
    """Convert a recording to a robot log.

    For data of your own in other formats see pmcl.RobotLog.build and 'pmcl example own_robot'.
    """


def _options_of_recordings(period: float, max_offset: str) -> Callable[[Command], Command]:
    """Return the options that recordings with landmarks share; `period` is the default [s]."""
    options = (
        output_option("The log to write (NetCDF)."),
        click.option("--period", type=float, default=period, show_default=True, help="Time between rows [s]."),
        click.option(
            "--start",
            type=click.Choice(["reference", "anywhere"]),
            default="reference",
            show_default=True,
            help="What is believed about the first pose. reference: the true pose within 0.1 m and 0.1 rad. "
            "anywhere: nothing.",
        ),
        click.option(
            "--begin", type=float, default=0.0, show_default=True, help="Leave out what came before this time [s]."
        ),
        click.option("--duration", type=float, help="How much to convert [s].  [default: to the end]"),
        click.option(
            "--max-offset",
            type=float,
            help="Leave out readings that are further in time from the nearest row than this [s].  [default: "
            f"{max_offset}]",
        ),
    )

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@convert.command(short_help="UTIAS multi-robot localization and mapping: barcodes seen by a camera.")
@click.argument("source", metavar="FOLDER")
@click.option("--robot", type=int, default=1, show_default=True, help="Number of the robot, N in RobotN_*.dat.")
@_options_of_recordings(period=0.5, max_offset="half the period, which keeps all")
def mrclam(source: str, robot: int, output: Path, **settings: Any) -> None:
    """UTIAS multi-robot localization and mapping: a FOLDER with RobotN_Odometry.dat and the other tables."""
    from pmcl.logs.mrclam import read_mrclam

    write_log(read_mrclam(source, robot, settings.pop("period"), **settings), output)


@convert.command(short_help="Lost in the Woods, course data of T. Barfoot: tubes seen by a laser.")
@click.argument("source", metavar="FILE")
@_options_of_recordings(period=1.0, max_offset="0.05")
def barfoot(source: str, output: Path, **settings: Any) -> None:
    """Lost in the Woods, course data of T. Barfoot: FILE is dataset2.mat, or the folder that holds it."""
    from pmcl.logs.barfoot import read_barfoot

    if settings["max_offset"] is None:
        del settings["max_offset"]  # this reader has a default of its own
    write_log(read_barfoot(source, settings.pop("period"), **settings), output)


def write_log(log: RobotLog, output: Path) -> None:
    """Write a log, and say what is in it and what was left out.

    Raises
    ------
    LogError
        When nothing was measured in it: such a log is of no use, and something went wrong.
    """
    from pmcl.logs.finding import warn_of
    from pmcl.logs.grid_map import map_to_name
    from pmcl.logs.validation import fail
    from pmcl.preflight.check import disagreements

    dropped = {name: value for name, value in log.dataset.attrs.items() if str(name).startswith("dropped_") and value}
    left_out = ", ".join(
        f"{value} ({str(name).removeprefix('dropped_').replace('_', ' ')})" for name, value in dropped.items()
    )
    if not log.n_readings:
        fail(
            log.where,
            f"expected readings in the {log.n_steps} rows, got none{left_out and f'; left out: {left_out}'}: check "
            "that sensors and odometry were recorded together, and the settings",
        )
    log.write(output)
    # Mistakes that the numbers show by themselves were reported when the log was built.
    warn_of(disagreements(log), str(output))
    span = log.times[-1] - log.times[0]
    click.echo(f"{output}: {log.robot}, {log.n_steps} samples over {span:.0f} s, {log.n_readings} readings")
    if left_out:
        click.echo(f"readings left out: {left_out}")
    if log.grid_map is not None and map_to_name(log.grid_map, str(output)) is None:
        click.echo("the map is not in the folder of the log: give --map to the commands that use it")
