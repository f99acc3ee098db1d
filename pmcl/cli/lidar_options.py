"""Options of commands that convert recordings with lidars, and the numbers that they take."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pmcl.defaults import MAX_BEAMS, UPDATE_MIN_A, UPDATE_MIN_D, UPDATE_RULES

if TYPE_CHECKING:
    from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["lidar_options", "map_at", "max_beams_or_all", "pose_or_word", "three_numbers"]

Command = TypeVar("Command", bound=Callable[..., Any])


def three_numbers(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    """Turn ``X,Y,YAW`` into three numbers [m, m, rad]."""
    if text is None:
        return None
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(
            f"expected X,Y,YAW in metres and radians, but got '{text}': write for example 1.5,2,-0.1", ctx, param
        )
    return numbers


def pose_or_word(ctx: click.Context, param: click.Parameter, text: str | None) -> str | tuple[float, ...] | None:
    """Turn the value of ``--start`` into one of its words, or three numbers [m, m, rad]."""
    if text is None or text in ("reference", "anywhere"):
        return text
    if "," not in text:
        raise click.BadParameter(
            f"expected reference, anywhere, or X,Y,YAW in metres and radians, but got '{text}': choose one", ctx, param
        )
    return three_numbers(ctx, param, text)


def max_beams_or_all(ctx: click.Context, param: click.Parameter, number: int) -> int | None:
    """Turn the value of ``--max-beams`` into what the readers take: 0 means all."""
    if number != 0 and number < 2:
        raise click.BadParameter(f"expected at least 2 rays, or 0 for all, but got {number}: choose 60", ctx, param)
    return number or None


def map_at(path: str | None) -> OccupancyGrid | None:
    """Read the map that ``--map`` names, if it is given."""
    if path is None:
        return None
    from pmcl.maps.occupancy_grid import OccupancyGrid

    return OccupancyGrid.read(path)


def lidar_options() -> Callable[[Command], Command]:
    """Return the options that say which scans become rows, and what is known about the start."""
    options = (
        click.option(
            "--update-min-d",
            type=click.FloatRange(min=0.0),
            default=UPDATE_MIN_D,
            show_default=True,
            help="Use a scan when the robot has moved by more than this since the last one [m]. The default is nav2's.",
        ),
        click.option(
            "--update-min-a",
            type=click.FloatRange(min=0.0),
            default=UPDATE_MIN_A,
            show_default=True,
            help="Or when it has turned by more than this [rad]. The default is nav2's; both 0: use every scan.",
        ),
        click.option(
            "--update-rule",
            type=click.Choice(UPDATE_RULES),
            default=UPDATE_RULES[0],
            show_default=True,
            help="How distance is judged. nav2: along x or along y of the odometry frame. euclidean: as beluga does.",
        ),
        click.option(
            "--max-beams",
            type=int,
            default=MAX_BEAMS,
            show_default=True,
            callback=max_beams_or_all,
            help="About how many rays to keep of each scan, evenly spread as nav2 does; 0: all.",
        ),
        click.option(
            "--begin",
            type=float,
            default=0.0,
            show_default=True,
            help="Leave out what came before this time, counted from the first usable scan [s].",
        ),
        click.option("--duration", type=float, help="How much to convert [s].  [default: to the end]"),
        click.option(
            "--start",
            metavar="reference|anywhere|X,Y,YAW",
            callback=pose_or_word,
            help="What is believed about the first pose. reference: the true pose within 0.1 m and 0.1 rad. "
            "X,Y,YAW: this pose of the map, as exactly [m, m, rad]. anywhere: nothing.  "
            "[default: reference if there is one, else anywhere]",
        ),
    )

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate
