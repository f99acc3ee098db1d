"""``pmcl effects``: the effects that the critic finds, models may have and simulations may contain."""

from __future__ import annotations

from pathlib import Path

import click

from pmcl.cli.options import effects_option, writable_file

__all__ = ["effects"]


@click.command(short_help="List the effects that pmcl knows, or describe one of them.")
@click.argument("name", required=False)
@click.option(
    "--html",
    type=click.Path(path_type=Path),
    metavar="FILE",
    callback=writable_file,
    help="Write the catalogue as a page (HTML, one file) instead.",
)
@effects_option()
def effects(name: str | None, html: Path | None) -> None:
    """List the effects that the default models leave out, or describe the effect NAME.

    'pmcl criticize' looks for them, 'pmcl simulate --effect' simulates them, and a model file can hold them.
    """
    from pmcl.models.effects.registry import known_effects
    from pmcl.models.effects.selection import effect_named
    from pmcl.reports.effects_page import effect_text, effects_text, write_effects_page

    chosen = known_effects() if name is None else (effect_named(name),)
    if html is not None:
        write_effects_page(html, chosen)
        click.echo(f"effects: {html}")
    else:
        click.echo(effects_text(chosen) if name is None else effect_text(chosen[0]))
