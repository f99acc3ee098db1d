"""``pmcl simulate``: logs of robots that exist only as numbers."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.options import output_option, parameter_values, seed_option

__all__ = ["simulate"]


@click.group()
def simulate() -> None:
    """Simulate a robot and write its log, with the truth beside."""


@simulate.command()
@output_option("The log to write (NetCDF).")
@click.option("--duration", type=float, default=400.0, show_default=True, help="Seconds; one row per second.")
@seed_option()
@click.option(
    "--theta",
    metavar="NAME=VALUE",
    multiple=True,
    callback=parameter_values,
    help="True value of a parameter (may be repeated); the others are drawn from their priors.",
)
def amigobot(output: Path, duration: float, seed: int, theta: dict[str, float]) -> None:
    """Simulate the paper's Amigobot: eight sonars in an L-shaped room."""
    from pmcl.robots.amigobot import simulate_amigobot

    log = simulate_amigobot(duration, seed, theta, where="simulate amigobot")
    log.write(output)
    click.echo(f"{output}: {log.n_steps} samples, {log.n_readings} readings")
    click.echo("truth: " + ", ".join(f"{name} = {value:.4g}" for name, value in (log.true_theta or {}).items()))
