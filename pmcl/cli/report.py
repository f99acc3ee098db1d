"""``pmcl report``: a page about a posterior, and the lines that all commands print about one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmcl.cli.application import DOES_NOT_FIT, NOT_CONVERGED
from pmcl.cli.options import output_option
from pmcl.errors import PosteriorError

if TYPE_CHECKING:
    from pmcl.posterior.compat import Posterior

__all__ = ["print_verdict", "report"]


@click.command(short_help="Write one page about a posterior: verdict, table, figures.")
@click.argument("posterior", metavar="POSTERIOR.nc")
@output_option("The page to write (HTML, one file).")
def report(posterior: str, output: Path) -> None:
    """Write one self-contained page about a posterior: verdict, path, parameters, chains, settings.

    Exit status 0 when the page is written, whatever the verdict says.
    """
    from pmcl.posterior.diagnostics import verdict
    from pmcl.posterior.files import read_posterior
    from pmcl.reports.posterior_report import write_report

    data = read_posterior(posterior)
    try:
        message = verdict(data).message
        write_report(data, output)
    except PosteriorError as error:
        raise PosteriorError(f"{posterior}: {error}") from None
    click.echo(message)
    click.echo(f"report: {output}")


def print_verdict(data: Posterior) -> int:
    """Print table and verdict of a posterior; return the exit status that both halves of the verdict mean."""
    from pmcl.posterior.diagnostics import summarize, verdict
    from pmcl.reports.tables import summary_text

    summary = summarize(data)
    click.echo(summary_text(data, summary))
    click.echo()
    judged = verdict(data, summary)
    for line in (judged.message, *judged.advice):
        click.echo(line)
    if not judged.converged:
        return NOT_CONVERGED
    return 0 if judged.good else DOES_NOT_FIT
