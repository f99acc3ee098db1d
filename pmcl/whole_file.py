"""Files that are written whole or not at all."""

from __future__ import annotations

import glob
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pmcl.errors import PmclError, PosteriorError

__all__ = ["remove_rests", "replacing", "write_whole"]

# What a file of HDF5 needs besides its arrays: headers, names and attributes [byte].
_HEADERS = 2**20


@contextmanager
def replacing(
    path: str | os.PathLike[str], *, n_bytes: int = 0, keep: bool = True, error: type[PmclError] = PosteriorError
) -> Iterator[Path]:
    """Yield a temporary file name beside `path`; the file takes the place of `path` when no error occurs.

    Parameters
    ----------
    path : path-like
        The final file. A symbolic link stays one: its target is what gets replaced.
    n_bytes : int
        About how large the file will be [byte]. So much space is asked for before anything is written, since HDF5
        crashes where the disk gets full.
    keep : bool
        Whether the file takes the place of `path`; otherwise writing is only tried, and the file removed.
    error : type of PmclError
        The error to raise.

    Yields
    ------
    pathlib.Path
        The temporary file.

    Raises
    ------
    PmclError
        If the file cannot be written; an existing file is then left as it was.
    """
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name}.{os.getpid()}.{secrets.token_hex(4)}.part")
    try:
        if n_bytes:
            _reserve(temporary, n_bytes + _HEADERS)
        yield temporary
        with open(temporary, "rb") as stream:
            os.fsync(stream.fileno())
        if keep:
            temporary.replace(target)
            _keep_name(target.parent)
    except OSError as problem:
        raise error(
            f"expected a place to write {path}, got {problem.strerror or problem}: check that the folder exists, "
            "can be written and has space"
        ) from problem
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_whole(
    path: str | os.PathLike[str], content: bytes | memoryview, *, error: type[PmclError] = PosteriorError
) -> None:
    """Write bytes to a file, which is then complete or as it was.

    Parameters
    ----------
    path : path-like
        The file.
    content : bytes
        What it will hold.
    error : type of PmclError
        The error to raise when the file cannot be written; an existing file is then left as it was.
    """
    with replacing(path, error=error) as temporary:
        temporary.write_bytes(content)


def remove_rests(path: str | os.PathLike[str]) -> None:
    """Remove what writers of a file left that were killed; only the process that alone may write the file may call it.

    Parameters
    ----------
    path : path-like
        The final file, which stays as it is.
    """
    target = Path(os.path.realpath(path))
    with suppress(OSError):
        for rest in target.parent.glob(f".{glob.escape(target.name)}.*.part"):
            with suppress(OSError):
                rest.unlink()


def _keep_name(folder: Path) -> None:
    """Write a folder to disk: else a crash of the machine may undo a renaming, though what came after it is kept."""
    # Windows opens no folders, and some file systems do not write them on demand.
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _reserve(path: Path, n_bytes: int) -> None:
    """Take space on the disk; raises OSError when there is less."""
    with open(path, "wb") as stream:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), 0, n_bytes)
