"""Checkpoints changed by somebody who gives them a new digest, as a program that means harm would."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from pmcl.sampling.checkpoint_head import N_BYTES, read_head, seal

__all__ = ["changed_checkpoint", "with_head"]


@contextmanager
def changed_checkpoint(path: Path) -> Iterator[h5py.File]:
    """Open a checkpoint to be changed, and give it a head for what it holds then."""
    head = read_head(path)
    assert head is not None
    with h5py.File(path, "r+") as file:
        yield file
    content = bytearray(path.read_bytes())
    seal(memoryview(content), head.run)
    path.write_bytes(content)


def with_head(content: bytes, *, layout: object = None, run: str | None = None) -> bytes:
    """Return a checkpoint whose head tells another layout or another run; the digest fits."""
    changed = bytearray(content)
    if run is not None:
        seal(memoryview(changed), run)
    if layout is not None:
        _, _, rest = bytes(changed[:N_BYTES]).partition(b"\n")
        first = f"pmcl checkpoint {layout}\n".encode()
        changed[:N_BYTES] = (first + rest).rstrip(b"\0").ljust(N_BYTES, b"\0")
    return bytes(changed)
