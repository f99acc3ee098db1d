"""``pmcl effects``: what the critic can name, a model can hold and a robot can be simulated with."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.options import writable_file

__all__ = ["effects"]


@click.command()
@click.argument("name", required=False)
@click.option(
    "--html",
    type=click.Path(path_type=Path),
    metavar="FILE",
    callback=writable_file,
    help="Write the catalogue as a page (HTML, one file) instead.",
)
def effects(name: str | None, html: Path | None) -> None:
    """List the effects that a model of noise alone leaves out, or tell all about one of them."""
    from pmcl.models.effects.catalogue import CATALOGUE
    from pmcl.models.effects.selection import effect_named
    from pmcl.reports.effects_page import effect_text, effects_text, write_effects_page

    chosen = CATALOGUE if name is None else (effect_named(name),)
    if html is not None:
        write_effects_page(html, chosen)
        click.echo(f"effects: {html}")
    else:
        click.echo(effects_text() if name is None else effect_text(chosen[0]))
