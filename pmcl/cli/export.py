"""``pmcl export``: a posterior as a file for another program."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.options import output_option, protect_inputs
from pmcl.errors import PosteriorError

__all__ = ["export"]

_FORMATS = ["nav2", "beluga", "ros1", "ros2_controllers", "static-transforms", "json"]


@click.command(short_help="Write a posterior as parameters of nav2, beluga, ROS 1 or ros2_controllers.")
@click.argument("posterior", metavar="POSTERIOR.nc")
@click.option(
    "--format", "format_", type=click.Choice(_FORMATS), required=True,
    help="nav2, beluga, ros1: parameters of AMCL. ros2_controllers: wheel multipliers of a differential drive. "
    "static-transforms: commands that publish where the lasers sit. json: everything, for programs.",
)  # fmt: skip
@output_option("The file to write (YAML, JSON or commands).")
@click.option(
    "--estimate", type=click.Choice(["mean", "map"]), default="mean", show_default=True,
    help="Which value. mean: the posterior mean. map: the draw of the greatest joint density.",
)  # fmt: skip
@click.option(
    "--wheel-separation", type=float, metavar="M",
    help="Wheel separation that the log's odometry was computed with [m], for wheels of unequal size.",
)  # fmt: skip
@click.pass_context
def export(
    ctx: click.Context, /, posterior: str, format_: str, output: Path, estimate: str, wheel_separation: float | None
) -> None:
    """Write a posterior in the names, units and meaning of another program.

    Each line says how well the log tells its value. Weights of a likelihood field are exact for the model
    likelihood_field_prob, which the file chooses; a beam model can only be approximated, and the file says so.
    """
    protect_inputs(ctx, output, [posterior])

    from pmcl.exports.export import export_text
    from pmcl.posterior.files import read_posterior
    from pmcl.whole_file import replacing

    data = read_posterior(posterior)
    try:
        text = export_text(data, format_, estimate=estimate, wheel_separation=wheel_separation)
    except PosteriorError as error:
        raise PosteriorError(f"{posterior}: {error}") from None
    with replacing(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    click.echo(f"{format_}: {output}")
