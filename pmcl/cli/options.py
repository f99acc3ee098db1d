"""Options that several commands share."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import click

__all__ = [
    "effects_option",
    "map_option",
    "output_folder",
    "output_option",
    "parameter_values",
    "progress_option",
    "protect_inputs",
    "scheduler_option",
    "seed_option",
    "wants_progress",
    "writable_file",
]

Command = TypeVar("Command", bound=Callable[..., Any])


def writable_file(ctx: click.Context, param: click.Parameter, path: Path | None) -> Path | None:
    """Check a file to be written before any work is done: hours of sampling must not end in a missing folder."""
    if path is None:
        return None
    if path.is_dir():
        raise click.BadParameter(f"expected a file to write, but got the folder {path}: add a file name", ctx, param)
    output_folder(ctx, param, path.parent)
    return path


def output_folder(ctx: click.Context, param: click.Parameter, path: Path) -> Path:
    """Check that a folder exists and can be written."""
    if not path.is_dir():
        raise click.BadParameter(f"expected an existing folder, but there is no folder {path}: create it", ctx, param)
    if not os.access(path, os.W_OK | os.X_OK):
        raise click.BadParameter(
            f"expected a folder that can be written, but {path} cannot: choose another", ctx, param
        )
    return path


def protect_inputs(ctx: click.Context, output: Path, inputs: Iterable[str]) -> None:
    """Check that the output is none of the inputs."""
    for path in inputs:
        # Unlike Path.resolve, it takes links that lead in circles for what they are.
        if os.path.realpath(output) == os.path.realpath(path):
            raise click.UsageError(
                f"expected an output other than the input, but both are {path}: name another file", ctx
            )


def parameter_values(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> dict[str, float]:
    """Turn texts ``name=value`` into numbers by name."""
    values = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            values[name.strip()] = math.nan
        if not (name.strip() and math.isfinite(values[name.strip()])):
            raise click.BadParameter(
                f"expected name=value with a number in SI units, but got '{text}': write for example sigma_turn=0.03",
                ctx,
                param,
            )
    return values


def output_option(description: str, *, required: bool = True) -> Callable[[Command], Command]:
    """Return the option ``-o``; `description` says what the file is."""
    kind = click.Path(path_type=Path)
    return click.option(
        "-o", "--output", type=kind, required=required, metavar="FILE", callback=writable_file, help=description
    )


def effects_option() -> Callable[[Command], Command]:
    """Return the option ``--effects``: while the command runs, names may mean the effects of these files."""
    return click.option(
        "--effects",
        "effect_files",
        multiple=True,
        metavar="FILE.py",
        expose_value=False,
        is_eager=True,
        callback=_use_effects,
        help="Python file with effects of your own, which then count as known, and statistics of your own, which "
        "criticize tests (may be repeated); 'pmcl example own_effect' and 'own_statistic' print one.",
    )


def _use_effects(ctx: click.Context, param: click.Parameter, paths: tuple[str, ...]) -> None:
    if paths:
        from pmcl.criticism.scoring.statistics import statistics_in, use_statistics
        from pmcl.errors import ModelError
        from pmcl.models.effects.registry import effects_in, run_file, use_effects

        for path in map(Path, paths):
            module = run_file(path)
            effects, statistics = effects_in(module, path), statistics_in(module, path)
            if not effects and not statistics:
                raise ModelError(
                    f"{path}: expected at least one pmcl.models.effects.Effect or pmcl.criticism.Statistic, but the "
                    "file defines none; 'pmcl example own_effect' and 'pmcl example own_statistic' print some"
                )
            ctx.with_resource(use_effects(effects))
            ctx.with_resource(use_statistics(statistics))


def map_option() -> Callable[[Command], Command]:
    """Return the option ``--map``, which the command gets as ``map_file``."""
    return click.option(
        "--map",
        "map_file",
        metavar="MAP.yaml",
        help="Grid map of the surroundings: the YAML file of a map_server map, whose image lies beside it.  [default: "
        "the map that the log names, if it names one]",
    )


def seed_option(default: int = 0) -> Callable[[Command], Command]:
    """Return the option ``--seed``."""
    kind = click.IntRange(min=0)
    text = "Seed of all random numbers; the same seed gives the same result."
    return click.option("--seed", type=kind, default=default, show_default=True, help=text)


def scheduler_option() -> Callable[[Command], Command]:
    """Return the option ``--scheduler``."""
    return click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Work on the cluster of this Dask scheduler, for example tcp://10.0.0.1:8786 (pip install 'pmcl[dask]').  "
        "[default: on this machine]",
    )


def progress_option(
    description: str = "No progress bars (there are none either off a terminal).",
) -> Callable[[Command], Command]:
    """Return the option ``--no-progress``; `description` says what it leaves out."""
    return click.option("--no-progress", is_flag=True, help=description)


def wants_progress(no_progress: bool) -> bool:
    """Return whether to show progress bars: on a terminal, unless told not to."""
    return not no_progress and sys.stderr.isatty()
