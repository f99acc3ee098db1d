"""``pmcl criticize``: find effects that the model of a log lacks."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from pmcl import defaults
from pmcl.cli.application import NOT_CONVERGED
from pmcl.cli.options import (
    effects_option,
    map_option,
    output_option,
    progress_option,
    protect_inputs,
    scheduler_option,
    seed_option,
    writable_file,
)

__all__ = ["criticize"]


@click.command(short_help="Find what the model of a log lacks, and name it.")
@click.argument("logs", metavar="LOG.nc...", nargs=-1, required=True)
@output_option("The page to write (HTML, one file).")
@click.option(
    "--json",
    "json_file",
    type=click.Path(path_type=Path),
    metavar="FILE.json",
    callback=writable_file,
    help="Write the result for other programs, too.",
)
@click.option(
    "--save-model",
    "better_model",
    type=click.Path(path_type=Path),
    metavar="BETTER.toml",
    callback=writable_file,
    help="Write the model with what was found, for calibrate --model and for a further criticize --model.",
)
@click.option(
    "--posterior",
    "better_posterior",
    type=click.Path(path_type=Path),
    metavar="BETTER.nc",
    callback=writable_file,
    help="Write the posterior of that model, for localize and report.",
)
@map_option()
@click.option(
    "--model",
    "model_file",
    metavar="FILE.toml",
    help="Model file of the model to criticise; without it the usual model of the log.",
)
@click.option(
    "--held-out",
    "held_out_file",
    metavar="OTHER.nc",
    help="Another log of the robot, on which gains and gaps are shown, and where an effect gains nothing. Without it "
    "the last part of the log is held out.",
)
@effects_option()
@click.option(
    "--particles", type=click.IntRange(min=50), default=defaults.CRITICISM_PARTICLES, show_default=True,
    help="Particles of the filter passes that score effects.",
)
@click.option(
    "--level", type=click.FloatRange(0.0, 0.5, min_open=True, max_open=True), default=defaults.FALSE_ALARM_LEVEL,
    show_default=True, help="Share of faultless logs that may raise an alarm.",
)  # fmt: skip
@click.option(
    "--rounds", type=click.IntRange(min=1), default=3, show_default=True,
    help="Greatest number of effects that are added. A robot whose map lacks things may need some more.",
)  # fmt: skip
@click.option("--joint/--no-joint", default=True, show_default=True,
    help="Calibrate the final model with full chains, or with one longer chain (faster).",)
@seed_option()
@scheduler_option()
@progress_option("Do not tell on stderr what is being tried, how many candidates are left, and the time so far.")
@click.pass_context
def criticize(
    ctx: click.Context,
    /,
    logs: tuple[str, ...],
    output: Path,
    json_file: Path | None,
    better_model: Path | None,
    better_posterior: Path | None,
    map_file: str | None,
    model_file: str | None,
    held_out_file: str | None,
    scheduler: str | None,
    no_progress: bool,
    joint: bool,
    **settings: Any,
) -> None:
    """Find where model and log disagree, name the missing effect, add it, and show the gap shrink.

    Several logs of one robot with the same sensors in the same surroundings are criticised together.
    """
    outputs = [file for file in (output, json_file, better_model, better_posterior) if file is not None]
    for file in outputs:
        protect_inputs(ctx, file, [path for path in (*logs, map_file, model_file, held_out_file) if path])
    if len({file.resolve() for file in outputs}) < len(outputs):
        raise click.UsageError("expected different files for the outputs, but two have the same name: rename one", ctx)
    if better_posterior is not None and not joint:
        raise click.UsageError(
            "--posterior is the result of the full chains that --no-joint leaves out: give one of the two", ctx
        )
    from pmcl.cli.report import print_verdict
    from pmcl.criticism.findings.verdict import next_drive_of
    from pmcl.criticism.workflow import criticize as run
    from pmcl.logs.joined import join_logs
    from pmcl.logs.robot_log import RobotLog
    from pmcl.models.model_file import read_model
    from pmcl.preflight.check import checked_logs
    from pmcl.reports.criticism_report import write_criticism_report

    robot_logs = [RobotLog.read(log, map_file) for log in logs]
    model = read_model(model_file, robot_logs[0]) if model_file is not None else None
    held_out = RobotLog.read(held_out_file, map_file) if held_out_file is not None else None
    settings |= {"held_out": held_out, "joint": joint, "posterior": better_posterior is not None}
    if scheduler is None:
        found = run(robot_logs, model, progress=not no_progress, **settings)
    else:
        from pmcl.fleet.cluster import cluster
        from pmcl.fleet.critic_run import criticize_elsewhere

        checked_logs(robot_logs, model)
        with cluster(scheduler) as place:
            found = criticize_elsewhere(place, join_logs(robot_logs), model, **settings)
    commands = _next_commands(logs, output, better_model, better_posterior, map_file)
    write_criticism_report(found, output, commands)
    if json_file is not None:
        found.write(json_file)
    if better_model is not None:
        found.write_model(better_model)
    click.echo(f"{found.verdict}: {found.sentence}.")
    for effect in found.effects:
        for clause in next_drive_of(effect):
            click.echo(f"{effect.name}: {clause}")
    for note in found.notes:
        click.echo(f"note: {note}")
    status = 0
    if better_posterior is not None and found.posterior is None:
        click.echo(f"no posterior: chains lose the robot, too; the notes of {output} say more", err=True)
        better_posterior, status = None, NOT_CONVERGED
    elif better_posterior is not None:
        found.write_posterior(better_posterior)
        status = print_verdict(found.posterior)
    for name, written in (("report", output), ("model", better_model), ("posterior", better_posterior)):
        if written is not None:
            click.echo(f"{name}: {written}")
    if found.effects:
        click.echo("next:")
        for purpose, command in commands:
            click.echo(f"  {command}   # {purpose}")
    ctx.exit(status)


def _next_commands(
    logs: tuple[str, ...], page: Path, model: Path | None, posterior: Path | None, map_file: str | None
) -> list[tuple[str, str]]:
    """Return what to do with the files that were written, or how to get them: purposes and commands."""

    def command(name: str, *words: str | Path) -> str:
        # Another drive is in the same surroundings; a report needs no map.
        of_map = ["--map", map_file] if map_file and name != "report" else []
        return shlex.join(["pmcl", name, *(str(word) for word in words), *of_map])

    commands = []
    if posterior is not None:
        commands.append((
            "follow the robot on another drive with what was found",
            command("localize", "OTHER.nc", "--posterior", posterior, "-o", "track.nc"),
        ))
        commands.append(("look at the posterior", command("report", posterior, "-o", "posterior.html")))
    if model is not None:
        commands.append((
            "calibrate the better model on another drive",
            command("calibrate", "OTHER.nc", "--model", model, "-o", "other_posterior.nc"),
        ))
        commands.append((
            "look for what that drive shows besides",
            command("criticize", "OTHER.nc", "--model", model, "-o", "other.html"),
        ))
    if not commands:
        files = ("--save-model", "better.toml", "--posterior", "better.nc")
        commands.append(("keep model and posterior as files", command("criticize", *logs, "-o", page, *files)))
    return commands
