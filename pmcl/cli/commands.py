"""The commands, put together."""

from __future__ import annotations

import click

from pmcl.cli.application import Application
from pmcl.cli.calibrate import calibrate
from pmcl.cli.compare import compare
from pmcl.cli.convert import convert
from pmcl.cli.convert_lidars import bag, carmen, csv, wean
from pmcl.cli.criticize import criticize
from pmcl.cli.demo import demo
from pmcl.cli.effects import effects
from pmcl.cli.example import example
from pmcl.cli.export import export
from pmcl.cli.fleet import fleet
from pmcl.cli.identify import identify
from pmcl.cli.localize import localize
from pmcl.cli.report import report
from pmcl.cli.simulate import simulate

__all__ = ["pmcl"]


@click.group(cls=Application, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="pmcl", message="pmcl %(version)s")
def pmcl() -> None:
    """Bayesian calibration for Monte Carlo localization.

    From what a robot logged and a map to the posterior of the noise parameters of its motion and sensors.
    Exit status: 0 done, 2 bad input or usage, 3 the chains have not converged,
    4 they have, but readings and model disagree.
    """


_COMMANDS = (
    demo, simulate, convert, identify, calibrate, fleet, criticize, compare, localize, export, report, effects, example,
)  # fmt: skip
for command in _COMMANDS:
    pmcl.add_command(command)

for command in (bag, carmen, csv, wean):
    convert.add_command(command)
