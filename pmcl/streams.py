"""Named streams of random numbers: what follows from one seed, without sums of seeds that meet those of other runs."""

from __future__ import annotations

import zlib

import numpy as np

__all__ = ["stream", "stream_seed"]


def stream(seed: int, *name: str | int) -> np.random.SeedSequence:
    """Return the stream of random numbers that a run with a seed uses for one purpose.

    Parameters
    ----------
    seed : int
        Seed of the run.
    *name : str or int
        The purpose, e.g. ``"simulated log", 3``; numbers from 0 to 2^32 - 1. It becomes the spawn key of the sequence.
        Streams with different seeds or names are independent.

    Returns
    -------
    numpy.random.SeedSequence
    """
    key = [zlib.crc32(part.encode()) if isinstance(part, str) else part for part in name]
    return np.random.SeedSequence(seed, spawn_key=key)


def stream_seed(seed: int, *name: str | int) -> int:
    """Return a seed of 63 bits from a named stream, for functions that take a number.

    Parameters
    ----------
    seed, *name
        As for :func:`stream`.

    Returns
    -------
    int
    """
    return int(stream(seed, *name).generate_state(1, np.uint64)[0] >> np.uint64(1))
