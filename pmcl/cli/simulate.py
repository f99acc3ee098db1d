"""``pmcl simulate``: logs of robots that exist only as numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pmcl import defaults
from pmcl.cli.options import effects_option, output_option, parameter_values, seed_option

if TYPE_CHECKING:
    from pmcl.logs.robot_log import RobotLog

__all__ = ["simulate"]

Command = TypeVar("Command", bound=Callable[..., Any])


@click.group(short_help="Simulate a robot and write its log, with the truth in it.")
def simulate() -> None:
    """Simulate a robot and write its log, with the true path and the true parameters in it."""


def _options_of_robots(command: Command) -> Command:
    """Return the options that all simulated robots share."""
    options = (
        output_option("The log to write (NetCDF)."),
        click.option(
            "--duration",
            type=float,
            default=defaults.SIMULATION_DURATION,
            show_default=True,
            help="Length of the log [s]; it has one row per second.",
        ),
        seed_option(),
        click.option(
            "--theta",
            metavar="NAME=VALUE",
            multiple=True,
            callback=parameter_values,
            help="True value of a parameter (may be repeated); the others are drawn from their priors.",
        ),
        click.option(
            "--effect",
            "effects",
            metavar="NAME[@PLACE][=VALUE]",
            multiple=True,
            help="Add an effect that the default model lacks, e.g. range-bias=0.05, beam-bias@2=large (may be "
            "repeated). Without a place one is drawn; without a value the effect has its clear size. 'pmcl effects' "
            "lists the effects.",
        ),
        effects_option(),
        click.option("--hide-effects", is_flag=True, help="Do not write into the log which effects are in it."),
    )
    for option in reversed(options):
        command = option(command)
    return command


@simulate.command(short_help="The paper's Amigobot: eight sonars in an L-shaped room.")
@_options_of_robots
def amigobot(output: Path, duration: float, seed: int, theta: dict[str, float], **effects: Any) -> None:
    """Simulate the paper's Amigobot: eight sonars in an L-shaped room."""
    from pmcl.simulations.amigobot import simulate_amigobot

    _write(simulate_amigobot(duration, seed, theta, **effects, where="simulate amigobot"), output)


@simulate.command(short_help="The paper's AIBO: a camera that sees coloured landmarks.")
@_options_of_robots
def aibo(output: Path, duration: float, seed: int, theta: dict[str, float], **effects: Any) -> None:
    """Simulate the paper's AIBO: a camera that sees coloured landmarks at the corners of a field."""
    from pmcl.simulations.aibo import simulate_aibo

    _write(simulate_aibo(duration, seed, theta, **effects, where="simulate aibo"), output)


def _write(log: RobotLog, output: Path) -> None:
    log.write(output)
    click.echo(f"{output}: {log.n_steps} samples, {log.n_readings} readings")
    click.echo("truth: " + ", ".join(f"{name} = {value:.4g}" for name, value in (log.true_theta or {}).items()))
