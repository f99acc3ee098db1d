"""``pmcl fleet``: many robots, each calibrated by itself, here or on a cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmcl import defaults
from pmcl.cli.application import BAD_INPUT, DOES_NOT_FIT, NOT_CONVERGED, on_interrupt
from pmcl.cli.method_options import MethodCommand, chosen_method
from pmcl.cli.options import effects_option, map_option, output_folder, progress_option, scheduler_option, seed_option

if TYPE_CHECKING:
    from pmcl.fleet.places import Place
    from pmcl.fleet.result import FleetResult
    from pmcl.fleet.workflow import FleetRun
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.robot_model import RobotModel

__all__ = ["fleet"]

_COUNT = click.IntRange(min=1)


def _new_folder(ctx: click.Context, param: click.Parameter, path: Path) -> Path:
    return path if path.is_dir() else output_folder(ctx, param, path.parent) / path.name


@click.command(cls=MethodCommand, short_help="Calibrate many robots, here or on a cluster.")
@click.argument("logs", metavar="LOG.nc...", nargs=-1, required=True)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), required=True, metavar="FOLDER",
    callback=_new_folder,
    help="Folder of the results, which is made when it is not there. ROBOT.nc is the posterior of the log ROBOT.nc. "
    "Robots that are in it already are skipped, so that the same command goes on after an interruption.",
)  # fmt: skip
@scheduler_option()
@click.option(
    "--workers", type=_COUNT, default=os.cpu_count() or 1, metavar="N",
    help="Robots that are calibrated at once, each in a process of its own, where there is no --scheduler.  "
    "[default: one for each core]",
)  # fmt: skip
@map_option()
@click.option(
    "--model",
    "model_file",
    metavar="FILE.toml",
    help="Model file for all robots; without it the usual model of each log.",
)
@effects_option()
@click.option("--draws", type=_COUNT, default=defaults.DRAWS, show_default=True, help="Draws of each chain.")
@click.option("--chains", type=_COUNT, default=defaults.CHAINS, show_default=True, help="Chains of each robot.")
@seed_option()
@click.option(
    "--critic", is_flag=True,
    help="Let the critic look at each robot, too, and keep what it says in FOLDER/ROBOT.critic.json. A file that "
    "'pmcl criticize --json' wrote to this place is used in any case.",
)  # fmt: skip
@progress_option("Do not tell on stderr how far each robot is.")
@click.pass_context
def fleet(
    ctx: click.Context,
    /,
    logs: tuple[str, ...],
    output: Path,
    scheduler: str | None,
    workers: int,
    map_file: str | None,
    model_file: str | None,
    method: str,
    draws: int,
    chains: int,
    seed: int,
    critic: bool,
    no_progress: bool,
    **method_settings: Any,
) -> None:
    """Calibrate many robots, one log each, on the cores of this machine or on a Dask cluster, and compare them.

    What a robot's posterior says does not depend on where it was made: it is that of 'pmcl calibrate'. The files
    fleet.html and fleet.json in FOLDER tell mean and spread of each parameter over the robots, which robot stands out,
    and what the critic found in most of them. A robot that cannot be calibrated is told at the end and stops no other.
    Exit status: 0 all is well, 2 some robots have no posterior, 3 the chains of some have not converged, 4 all have,
    but the readings and the model of some disagree.
    """
    chosen = chosen_method(ctx, method, method_settings)
    names = _names(ctx, logs, output)

    from pmcl.fleet.critic_run import criticize_fleet
    from pmcl.fleet.summary import summarize_fleet
    from pmcl.fleet.workflow import calibrate_fleet
    from pmcl.reports.fleet_report import write_fleet_report

    on_interrupt(ctx, f"robots that are done, and checkpoints of others, are in {output}: the same command goes on")
    robot_logs, models = _inputs(names, map_file, model_file)
    tell = _Lines(len(logs), show=not no_progress)
    with _place(scheduler, workers, len(logs)) as place:
        run = calibrate_fleet(
            robot_logs, output, models, method=chosen, draws=draws, chains=chains, seed=seed, pool=place, tell=tell
        )
        findings, errors = criticize_fleet(robot_logs, output, models, place, tell, run=critic, seed=seed)
    result = summarize_fleet(run, findings, errors)
    result.write(output / "fleet.json")
    write_fleet_report(result, output / "fleet.html")
    ctx.exit(_told(run, result, output))


def _names(ctx: click.Context, logs: tuple[str, ...], output: Path) -> dict[str, str]:
    """Return the paths by the names of the robots: those of the files."""
    names: dict[str, str] = {}
    for path in logs:
        name = Path(path).stem
        if name in names:
            raise click.UsageError(
                f"expected logs with different names, for robots are called after them, but {names[name]} and {path} "
                f"are both {name}: rename one",
                ctx,
            )
        names[name] = path
        if os.path.realpath(path) == os.path.realpath(output / f"{name}.nc"):
            raise click.UsageError(
                f"expected a folder without the logs, but the posterior of {path} would replace it: name another", ctx
            )
    return names


def _inputs(
    names: dict[str, str], map_file: str | None, model_file: str | None
) -> tuple[dict[str, RobotLog], dict[str, RobotModel] | None]:
    from pmcl.logs.robot_log import RobotLog
    from pmcl.maps.occupancy_grid import OccupancyGrid
    from pmcl.models.model_file import read_model

    grid = None if map_file is None else OccupancyGrid.read(map_file)
    logs = {name: RobotLog.read(path, grid) for name, path in names.items()}
    if model_file is None:
        return logs, None
    return logs, {name: read_model(model_file, log) for name, log in logs.items()}


@contextmanager
def _place(scheduler: str | None, workers: int, robots: int) -> Iterator[Place]:
    from pmcl.fleet.places import HerePlace, ProcessPlace

    if scheduler is not None:
        from pmcl.fleet.cluster import cluster

        with cluster(scheduler) as place:
            yield place
        return
    yield ProcessPlace(min(workers, robots)) if min(workers, robots) > 1 else HerePlace()


class _Lines:
    """Progress as lines on stderr: on a terminal all of it, elsewhere only which robots are done."""

    def __init__(self, robots: int, *, show: bool) -> None:
        self.robots, self.show, self.ended = robots, show, 0

    def __call__(self, name: str, message: str) -> None:
        final = message == "done" or message.startswith("failed")
        self.ended += final
        if self.show and (final or sys.stderr.isatty()):
            count = f" ({self.ended} of {self.robots})" if final else ""
            click.echo(f"{name}: {message}{count}", err=True)


def _told(run: FleetRun, result: FleetResult, folder: Path) -> int:
    """Print one line for each robot, and what there is to say of all; return the exit status."""
    if run.skipped:
        click.echo(f"there already: {', '.join(run.skipped)}", err=True)
    states = {BAD_INPUT} if run.errors else set()
    for robot in result.robots:
        if robot.posterior:
            click.echo(f"{robot.name}: {robot.message}")
            states.add(NOT_CONVERGED if not robot.converged else DOES_NOT_FIT if robot.adequate is False else 0)
    for sentence in result.sentences():
        click.echo(sentence)
    for name, error in run.errors.items():
        click.echo(f"pmcl: error: {name}: {error}", err=True)
    click.echo(f"posteriors: {folder}")
    click.echo(f"report: {folder / 'fleet.html'}")
    return next((state for state in (BAD_INPUT, NOT_CONVERGED, DOES_NOT_FIT) if state in states), 0)
