"""``pmcl convert bag``, ``carmen``, ``wean`` and ``csv``: recordings with lidars as robot logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmcl.cli.convert import write_log
from pmcl.cli.lidar_options import lidar_options, map_at, pose_or_word, three_numbers
from pmcl.cli.options import output_option, protect_inputs

if TYPE_CHECKING:
    from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["bag", "carmen", "csv", "wean"]


@click.command(short_help="A ROS 1 bag, a ROS 2 folder or an MCAP file: odometry and laser scans.")
@click.argument("source", metavar="FILE")
@output_option("The log to write (NetCDF).")
@click.option("--map", "map_path", metavar="MAP.yaml", help="The map, a map_server pair.")
@click.option(
    "--scan",
    "scans",
    multiple=True,
    metavar="TOPIC",
    help="Topic of a laser's scans (may be repeated).  [default: the only one]",
)
@click.option(
    "--odom",
    "odometry",
    metavar="TOPIC_OR_FRAME",
    help="Topic of the odometry, or its frame in tf.  [default: the only topic, else the frame odom]",
)
@click.option(
    "--truth",
    metavar="TOPIC_OR_FRAME",
    help="Reference trajectory of the robot, for scoring only: a topic of poses, or a frame of tf.",
)
@click.option(
    "--truth-to-map",
    metavar="X,Y,YAW",
    default="0,0,0",
    callback=three_numbers,
    help="Where the frame of the reference lies in that of the map [m, m, rad].",
)
@click.option(
    "--truth-shift",
    type=float,
    default=0.0,
    show_default=True,
    help="What to add to the stamps of the reference [s]: positive where they are early.",
)
@click.option(
    "--scan-stamp",
    type=click.Choice(["first", "last"]),
    default="first",
    show_default=True,
    help="Which ray of a scan its stamp belongs to. Rows have the time of the first one.",
)
@lidar_options()
@click.pass_context
def bag(ctx: click.Context, /, source: str, output: Path, map_path: str | None, **settings: Any) -> None:
    """Convert scans and odometry of a bag: a ROS 1 bag, a ROS 2 folder (sqlite3 or MCAP) or an MCAP FILE.

    The rows of the log are the scans that AMCL would use.
    """
    from pmcl.logs.bags.read import read_bag

    protect_inputs(ctx, output, [source])
    write_log(read_bag(source, grid_map=map_at(map_path), **settings), output)


@click.command(short_help="A text log of CARMEN: FLASER or ROBOTLASER1, and ODOM lines.")
@click.argument("source", metavar="FILE")
@output_option("The log to write (NetCDF).")
@click.option("--map", "map_path", metavar="MAP.yaml", help="The map, a map_server pair.")
@click.option(
    "--laser-pose",
    metavar="X,Y,YAW",
    callback=three_numbers,
    help="Where the laser sits on the robot [m, m, rad].  [default: what the log says]",
)
@lidar_options()
@click.pass_context
def carmen(ctx: click.Context, /, source: str, output: Path, map_path: str | None, **settings: Any) -> None:
    """Convert scans and odometry of a text log of CARMEN; FILE may be compressed by gzip.

    The rows of the log are the scans that AMCL would use.
    """
    from pmcl.logs.carmen import read_carmen

    protect_inputs(ctx, output, [source])
    write_log(read_carmen(source, grid_map=map_at(map_path), **settings), output)


# A line with the character \\b alone keeps click from wrapping the lines that follow.
_CSV_HELP = """Convert a table with one row for each sample, in metres, radians and seconds.

\b
Columns:
  time
  odometry_forward, odometry_left, odometry_turn   since the row before
  odom_x, odom_y, odom_heading                     or integrated poses
  range_0, range_1, ...                            single beams
  scan_0, scan_1, ...                              rays of a lidar
  range_to_NAME, bearing_to_NAME                   sightings of a landmark
  true_x, true_y, true_heading                     for scoring only

\b
Comments above the header, as far as the columns need them:
  # robot: NAME
  # beam_0: X Y YAW
  # max_range: M
  # wall: X1 Y1 X2 Y2
  # scan_pose: X Y YAW
  # scan_angles: FIRST STEP
  # scan_limits: MIN MAX
  # landmark NAME: X Y
  # landmark_sensor: X Y YAW
  # start: X Y YAW SX SY SYAW

An empty cell was not measured, inf is no echo.
"""


@click.command(help=_CSV_HELP, short_help="A CSV table of your own: time, odometry, ranges, scans, landmarks.")
@click.argument("source", metavar="TABLE.csv")
@output_option("The log to write (NetCDF).")
@click.option("--map", "map_path", metavar="MAP.yaml", help="The map of a lidar, a map_server pair.")
@click.option(
    "--sightings",
    metavar="SIGHTINGS.csv",
    help="A second table with the columns time, landmark, range, bearing: sightings at times of their own.",
)
@click.option(
    "--start",
    metavar="reference|anywhere|X,Y,YAW",
    callback=pose_or_word,
    help="What is believed about the first pose: the true pose or this one [m, m, rad], within 0.1 m and 0.1 rad, or "
    "nothing.  [default: what the table says, else anywhere]",
)
@click.pass_context
def csv(ctx: click.Context, /, source: str, output: Path, map_path: str | None, **settings: Any) -> None:
    """Convert a table with one row for each sample; see the help."""
    from pmcl.logs.csv_log import read_csv

    protect_inputs(ctx, output, [source])
    write_log(read_csv(source, grid_map=map_at(map_path), **settings), output)


@click.command(short_help="CMU Wean Hall: laser, odometry and a grid map of their own format.")
@click.argument("source", metavar="LOG")
@output_option("The log to write (NetCDF).")
@click.option(
    "--map",
    "map_path",
    metavar="MAP",
    help="The map: wean.dat or wean.dat.gz, which is also written beside the log as map_server pair, or a MAP.yaml.",
)
@lidar_options()
@click.pass_context
def wean(ctx: click.Context, /, source: str, output: Path, map_path: str | None, **settings: Any) -> None:
    """Convert a Wean Hall recording: LOG is a robotdataN.log, or a folder that holds one.

    The rows of the log are the scans that AMCL would use.
    """
    from pmcl.logs.wean import find_wean_log, read_wean

    protect_inputs(ctx, output, [source, str(find_wean_log(source))])
    write_log(read_wean(source, grid_map=_wean_map(ctx, map_path, output), **settings), output)


def _wean_map(ctx: click.Context, path: str | None, output: Path) -> OccupancyGrid | None:
    """Read the map; one of the recordings' own format is written beside the log, which can then name it."""
    if path is None or Path(path).suffix in (".yaml", ".yml"):
        return map_at(path)
    from pmcl.maps.wean import read_wean_map

    pair = output.with_name(f"{output.stem}_map.yaml")
    protect_inputs(ctx, pair, [path])
    grid = read_wean_map(path)
    grid.write(pair)
    return map_at(str(pair))
