"""``pmcl convert``: published recordings as robot logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pmcl.cli.options import output_option

if TYPE_CHECKING:
    from pmcl.logs.robot_log import RobotLog

__all__ = ["convert"]

Command = TypeVar("Command", bound=Callable[..., Any])


@click.group()
def convert() -> None:
    """Convert a recording to a robot log."""


def _options_of_recordings(period: float) -> Callable[[Command], Command]:
    """Return the options that recordings with landmarks share; `period` is the usual one [s]."""
    options = (
        output_option("The log to write (NetCDF)."),
        click.option("--period", type=float, default=period, show_default=True, help="Time between samples [s]."),
        click.option(
            "--start",
            type=click.Choice(["reference", "anywhere"]),
            default="reference",
            show_default=True,
            help="What is believed about the first pose: the reference within 0.1 m and 0.1 rad, or nothing.",
        ),
        click.option("--begin", type=float, default=0.0, show_default=True, help="Where to begin [s]."),
        click.option("--duration", type=float, help="How much to take [s]; all of it if not given."),
        click.option("--max-offset", type=float, help="Drop readings further from their sample than this [s]."),
    )

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@convert.command()
@click.argument("source", metavar="FOLDER")
@click.option("--robot", type=int, default=1, show_default=True, help="Number of the robot, N in RobotN_*.dat.")
@_options_of_recordings(period=0.5)
def mrclam(source: str, robot: int, output: Path, **settings: Any) -> None:
    """UTIAS multi-robot localization and mapping: a FOLDER with RobotN_Odometry.dat and so on."""
    from pmcl.logs.mrclam import read_mrclam

    _write(read_mrclam(source, robot, settings.pop("period"), **settings), output)


@convert.command()
@click.argument("source", metavar="FILE")
@_options_of_recordings(period=1.0)
def barfoot(source: str, output: Path, **settings: Any) -> None:
    """Lost in the Woods, T. Barfoot's course data: the MAT-FILE dataset2.mat, or its folder."""
    from pmcl.logs.barfoot import read_barfoot

    if settings["max_offset"] is None:
        del settings["max_offset"]  # this reader has a default of its own
    _write(read_barfoot(source, settings.pop("period"), **settings), output)


def _write(log: RobotLog, output: Path) -> None:
    log.write(output)
    span = log.times[-1] - log.times[0]
    click.echo(f"{output}: {log.robot}, {log.n_steps} samples over {span:.0f} s, {log.n_readings} readings")
    dropped = {name: value for name, value in log.dataset.attrs.items() if str(name).startswith("dropped_") and value}
    if dropped:
        told = ", ".join(
            f"{value} ({str(name).removeprefix('dropped_').replace('_', ' ')})" for name, value in dropped.items()
        )
        click.echo(f"readings left out: {told}")
