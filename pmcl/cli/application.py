"""How every command behaves: errors in one line, exit statuses, messages on stderr.

Exit status: 0 done, 2 bad input or usage, 3 the chains have not converged, 4 they have, but readings and model
disagree, 130 interrupted.
"""

from __future__ import annotations

import errno
import functools
import logging
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import click

from pmcl.errors import PmclError, one_line

__all__ = ["BAD_INPUT", "DOES_NOT_FIT", "INTERRUPTED", "NOT_CONVERGED", "Application", "on_interrupt"]

BAD_INPUT, NOT_CONVERGED, DOES_NOT_FIT, INTERRUPTED = 2, 3, 4, 130
_ON_INTERRUPT = "pmcl.on_interrupt"
# The errors of a device that can take no more.
_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EIO)


class Application(click.Group):
    """A group of commands whose failures are one line on stderr: what was expected, what came, where, what to do."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command line and exit, see :meth:`click.Command.main`."""
        extra |= {"args": args, "prog_name": prog_name, "complete_var": complete_var}
        run: Callable[[], Any] = functools.partial(super().main, standalone_mode=False, **extra)
        if not standalone_mode:
            return run()
        try:
            # What click returns here is the status given to Context.exit, or what a command returned: nothing.
            status: Any = run()
            if sys.stdout is not None:  # closed by who called the command
                sys.stdout.flush()
        except click.UsageError as error:
            status = _fail(_usage(error))
        except click.ClickException as error:
            status = _fail(error.format_message())
        except PmclError as error:
            status = _fail(str(error))
        except click.Abort:
            status = INTERRUPTED
        except OSError as error:
            if error.errno not in _NO_SPACE:
                raise
            # What files lack space is told where they are written; this is the standard output.
            status = _fail(f"expected that the output can be written, but got '{error.strerror}'; make space for it")
            # Python tries again to write the rest when it ends, and would fail once more.
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        sys.exit(status or 0)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command, with pmcl's messages as plain lines and without other libraries' warnings."""
        _show_messages()
        with warnings.catch_warnings():
            # They speak to programmers; python -W brings them back.
            if not sys.warnoptions:
                warnings.simplefilter("ignore")
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt:
                click.echo(f"pmcl: interrupted; {ctx.meta.get(_ON_INTERRUPT, 'nothing was written')}", err=True)
                ctx.exit(INTERRUPTED)


def on_interrupt(ctx: click.Context, message: str) -> None:
    """Say what an interrupted command leaves behind, or how to go on."""
    ctx.meta[_ON_INTERRUPT] = message


def _fail(message: str) -> int:
    click.echo(f"pmcl: error: {one_line(message)}", err=True)
    return BAD_INPUT


def _usage(error: click.UsageError) -> str:
    path = error.ctx.command_path if error.ctx is not None else "pmcl"
    if type(error).__name__ == "NoArgsIsHelpError":  # a class that older versions of click do not have
        return f"expected a command, but got none; see '{path} --help'"
    return f"{error.format_message().rstrip('.')} (see '{path} --help')"


class _PlainLines(logging.Handler):
    """Messages as lines on stderr, above a progress bar if there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message."""
        bars = sys.modules.get("tqdm")
        if bars is not None:
            bars.tqdm.write(self.format(record), file=sys.stderr)
        else:
            click.echo(self.format(record), err=True)


def _show_messages() -> None:
    logger = logging.getLogger("pmcl")
    if not any(isinstance(handler, _PlainLines) for handler in logger.handlers):
        logger.addHandler(_PlainLines())
        logger.setLevel(logging.INFO)
