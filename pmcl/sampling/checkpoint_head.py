"""The head of a checkpoint file: which layout it has, which run it belongs to, and the digest of all that follows.

HDF5 allows a user block before its own content, which its readers (h5py, emcee) skip. The head stands there, so that
a damaged file is refused before HDF5 reads a byte of it: HDF5 may search a damaged file without end, or return other
numbers than were written.
"""

from __future__ import annotations

import hashlib
import os
import re
from typing import NamedTuple

__all__ = ["LAYOUT", "N_BYTES", "CheckpointHead", "read_head", "seal"]

LAYOUT = 4
"""Which layout checkpoints have; it grows when they change."""

N_BYTES = 512
"""Length of the head [byte]. HDF5 asks for a power of two, and for 512 at least."""

_HEAD = "pmcl checkpoint {layout}\nrun {run}\ndigest {digest}\n"
_PATTERN = re.compile(rb"pmcl checkpoint (\d{1,9})\nrun ([0-9a-f]{64})\ndigest ([0-9a-f]{64})\n\0*")


class CheckpointHead(NamedTuple):
    """What the head of a file tells.

    Attributes
    ----------
    layout : int
        Layout of the file, see :data:`LAYOUT`.
    run : str
        Fingerprint of the run that wrote it.
    digest : str
        SHA-256 of the fingerprint and of all that follows the head.
    whole : bool
        Whether the file has this digest.
    """

    layout: int
    run: str
    digest: str
    whole: bool


def seal(content: memoryview, run: str) -> None:
    """Write the head of a checkpoint into its first bytes, which HDF5 left free.

    Parameters
    ----------
    content : memoryview
        The whole file, with a user block of ``N_BYTES`` at its beginning; changed in its place.
    run : str
        Fingerprint of the run: 64 hexadecimal digits.
    """
    digest = hashlib.sha256(run.encode())
    digest.update(content[N_BYTES:])
    head = _HEAD.format(layout=LAYOUT, run=run, digest=digest.hexdigest()).encode()
    content[:N_BYTES] = head.ljust(N_BYTES, b"\0")


def read_head(path: str | os.PathLike[str]) -> CheckpointHead | None:
    """Read the head of a checkpoint, and compare its digest with the rest of the file.

    Parameters
    ----------
    path : path
        A regular file.

    Returns
    -------
    CheckpointHead or None
        None when the file does not begin with a head.

    Raises
    ------
    OSError
        When the file cannot be read.
    """
    with open(path, "rb") as file:
        match = _PATTERN.fullmatch(file.read(N_BYTES))
        if match is None:
            return None
        layout, run, digest = (group.decode() for group in match.groups())
        found = hashlib.sha256(run.encode())
        while block := file.read(2**20):
            found.update(block)
    return CheckpointHead(int(layout), run, digest, found.hexdigest() == digest)
