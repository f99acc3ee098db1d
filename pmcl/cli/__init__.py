"""The command line, ``pmcl``: each command reads files, calls one function of the library, and writes files.

Commands import what they need when they run, so that ``pmcl --help`` answers at once. :mod:`~pmcl.cli.application`
turns errors into one line and an exit status. Output goes to people, and to files that other programs read.
"""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the command line; does not return."""
    from pmcl.cli.commands import pmcl

    pmcl()
