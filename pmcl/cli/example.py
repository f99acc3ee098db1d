"""``pmcl example``: files to start from."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.options import output_option

__all__ = ["example"]


@click.command(short_help="List the example files, or copy one to start from.")
@click.argument("name", required=False)
@output_option("The file to write; without it the example is printed.", required=False)
def example(name: str | None, output: Path | None) -> None:
    """List the examples, or print or copy the example NAME.

    Each is a short Python file that runs as it is: data of your own robot, an effect, a sensor, a statistic of your
    own.
    """
    from pmcl.examples import example_names, example_text

    if name is None:
        if output is not None:
            raise click.UsageError("expected the name of an example with -o, but got none; 'pmcl example' lists them")
        for known, summary in example_names().items():
            click.echo(f"{known:<14} {summary}")
        return
    text = example_text(name)
    if output is None:
        click.echo(text, nl=False)
        return
    try:
        with output.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        raise click.UsageError(
            f"expected a new file, but {output} exists and may hold your changes: name another file, or remove it"
        ) from None
    click.echo(f"example: {output}")
