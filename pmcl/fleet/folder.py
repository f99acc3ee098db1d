"""The folder of a fleet: one posterior for each robot, marked with the run that it belongs to."""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pmcl.engine.file_lock import FileLock
from pmcl.errors import SamplingError
from pmcl.posterior.compat import Posterior, attributes, extended
from pmcl.posterior.files import read_posterior, write_posterior

__all__ = ["SharedFolder", "check_names", "is_finished", "marked_bytes", "only_fleet", "posterior_file"]

KEY = "fleet_key"
"""Attribute of a posterior: a hash of log, model, priors, settings and version of its run."""


@dataclass(frozen=True)
class SharedFolder:
    """A folder as another process sees it, perhaps on another machine.

    Attributes
    ----------
    path : str
        Absolute.
    mark : str
        Name of a file in it; a process that does not see the file has another folder at this path, or none.
    """

    path: str
    mark: str

    def checkpoint(self, name: str) -> str | None:
        """Return the checkpoint of a robot; None where the folder is out of reach."""
        if not os.path.exists(os.path.join(self.path, self.mark)):
            return None
        return os.path.join(self.path, f"{name}.nc.checkpoint.h5")


def posterior_file(folder: Path, name: str) -> Path:
    """Return the file of a robot's posterior."""
    return folder / f"{name}.nc"


def check_names(names: list[str]) -> None:
    """Raise SamplingError for names of robots that cannot be names of files."""
    for name in names:
        if not name or name.startswith(".") or os.path.basename(name) != name:
            raise SamplingError(
                f"expected names of robots that can be names of files, but got {name!r}; name it for example 'robot7'"
            )


def is_finished(folder: Path, name: str, key: str) -> bool:
    """Return whether the folder holds a robot's posterior.

    Parameters
    ----------
    folder : Path
        The folder.
    name : str
        The robot.
    key : str
        Of its run.

    Raises
    ------
    SamplingError
        When the posterior is that of another run.
    PosteriorError
        When the file is damaged.
    """
    file = posterior_file(folder, name)
    if not file.exists():
        return False
    found = attributes(read_posterior(file)).get(KEY)
    if found != key:
        what = "has no mark of a fleet" if found is None else "belongs to another run"
        raise SamplingError(
            f"{file}: expected the posterior of this log, model and settings, but it {what} (log, model, priors, "
            "settings or pmcl's version differ); give another folder, or remove the file"
        )
    return True


def marked_bytes(data: Posterior, key: str) -> bytes:
    """Return the content of the file that holds a posterior with its mark."""
    with tempfile.TemporaryDirectory(prefix="pmcl-fleet-") as place:
        file = Path(place) / "posterior.nc"
        write_posterior(extended(data, {}, {KEY: key}), file)
        return file.read_bytes()


@contextmanager
def only_fleet(folder: Path) -> Iterator[SharedFolder]:
    """Make the folder and let no other fleet use it.

    Parameters
    ----------
    folder : Path
        The folder; the one that it is in must exist.

    Yields
    ------
    SharedFolder

    Raises
    ------
    SamplingError
        When another fleet is at work in it, or it cannot be written.
    """
    mark = Path(folder, f".fleet-{secrets.token_hex(8)}")
    try:
        folder.mkdir(exist_ok=True)
        mark.touch()
    except OSError as error:
        raise SamplingError(
            f"{folder}: expected a folder that can be written, but got '{error.strerror}'; choose another"
        ) from None
    try:
        with FileLock(folder / ".fleet.lock", f"process {os.getpid()} on {socket.gethostname()}") as lock:
            if not lock.acquire():
                raise SamplingError(
                    f"{folder}: expected a folder of its own, but another fleet is at work in it ({lock.owner()}); "
                    "let it end, or choose another folder"
                )
            yield SharedFolder(os.fspath(folder.resolve()), mark.name)
    finally:
        with contextlib.suppress(OSError):
            mark.unlink()
