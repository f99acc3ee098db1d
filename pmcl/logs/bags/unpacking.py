"""Compressed parts of bags, unpacked within limits: a few kilobytes from a stranger may stand for gigabytes.

A bag keeps its messages in chunks, each compressed by itself. The readers of rosbags unpack a chunk whatever comes out
of it. Here its size is checked first: for ROS 1 by giving the reader another function that unpacks, for MCAP by a look
at each chunk before the reader gets to it.
"""

from __future__ import annotations

import bz2
import importlib
import os
import struct
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

__all__ = ["Chunk", "check_index", "check_packed_file", "checked_chunks", "limit_chunks_of_ros1", "unpacked"]

LARGEST_CHUNK = 256 * 2**20
"""The greatest size of a chunk [byte]. Recorders begin a new one after 1 to 10 MB; one image of a large camera takes
60 MB. While a chunk is read, there are up to three copies of its messages in memory."""

# How many times smaller a whole recording may become: scans and transforms shrink to a third, repeated texts to a
# hundredth.
_LARGEST_RATIO = 1000
_LONGEST_FRAME_HEAD = 18  # of zstd (RFC 8878, section 3.1.1.1)

# MCAP (mcap.dev/spec): a magic number, then records of an opcode and a length of 8 bytes.
_MAGIC, _HEAD = 8, struct.Struct("<BQ")
_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
# A chunk begins with times of its first and last message, its unpacked size, a checksum, and the name of the method.
_CHUNK_HEAD = struct.Struct("<QQQII")
_LONGEST_NAME = 32


class Chunk(NamedTuple):
    """What the record of a chunk in an MCAP file says of it: method, size in the file and unpacked size [byte]."""

    method: str
    n_packed: int
    size: int


def _decompressor(method: str) -> Any:
    """Return an object that unpacks one stream: all libraries have the interface of Python's own bz2."""
    if method == "bz2":
        return bz2.BZ2Decompressor()
    if method == "lz4":
        return importlib.import_module("lz4.frame").LZ4FrameDecompressor()
    return _zstd().ZstdDecompressor()


def _zstd() -> Any:
    # Part of Python from 3.14 on; before, rosbags brings a package that is the same.
    return importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")


def unpacked(method: str, packed: bytes) -> bytes:
    """Unpack a chunk or a message.

    Parameters
    ----------
    method : {"bz2", "lz4", "zstd"}
        How it is compressed.
    packed : bytes
        One or several streams, one after the other.

    Returns
    -------
    bytes

    Raises
    ------
    ValueError
        When more than :data:`LARGEST_CHUNK` bytes come out.
    EOFError
        When the last stream is cut off. Damaged data raise what the library raises.
    """
    parts, n_bytes = [], 0
    while packed:
        decompressor = _decompressor(method)
        part = decompressor.decompress(packed, max_length=LARGEST_CHUNK - n_bytes + 1)
        parts.append(part)
        n_bytes += len(part)
        if n_bytes > LARGEST_CHUNK:
            raise ValueError(f"a chunk of more than {LARGEST_CHUNK >> 20} MB")
        if not decompressor.eof:
            raise EOFError("compressed data that are cut off")
        packed = decompressor.unused_data
    return parts[0] if len(parts) == 1 else b"".join(parts)


def check_packed_file(path: Path) -> None:
    """Check the size that a file of a bag says it has when it is unpacked into a temporary folder.

    Parameters
    ----------
    path : Path
        A file that is compressed as a whole, by zstd.

    Raises
    ------
    ValueError
        When it says a size that no recording shrinks from.
    """
    with path.open("rb") as stream:
        size = _zstd().get_frame_info(stream.read(_LONGEST_FRAME_HEAD)).decompressed_size
    if size is not None and size > LARGEST_CHUNK + _LARGEST_RATIO * path.stat().st_size:
        raise ValueError(f"a file of {path.stat().st_size} bytes that says it becomes {size} bytes")


def limit_chunks_of_ros1(reader: Any, decompressors: Mapping[str, Any]) -> None:
    """Let an open reader of a ROS 1 bag unpack its chunks by :func:`unpacked`.

    Parameters
    ----------
    reader : rosbags.rosbag1.Reader
        Its chunks are changed.
    decompressors : mapping of str to callable
        The functions that it would use, by method.
    """
    bounded = {decompressors[method]: partial(unpacked, method) for method in ("bz2", "lz4")}
    for position, chunk in reader.chunks.items():
        # A chunk that is not compressed stays as it is.
        limited = bounded.get(chunk.decompressor, chunk.decompressor)
        reader.chunks[position] = chunk._replace(decompressor=limited)


def checked_chunks(path: Path) -> dict[int, Chunk]:
    """Check all chunks of an MCAP file, before a reader unpacks them.

    Parameters
    ----------
    path : Path
        The file. Where it is damaged, checking ends: the reader will say so.

    Returns
    -------
    dict of int to Chunk
        By where the record of each chunk begins [byte].

    Raises
    ------
    ValueError
        When a chunk is too large. Damaged data raise what the library that unpacks them raises.
    """
    found: dict[int, Chunk] = {}
    with path.open("rb") as stream:
        stream.seek(_MAGIC)
        while len(head := stream.read(_HEAD.size)) == _HEAD.size:
            kind, length = _HEAD.unpack(head)
            begin = stream.tell()
            if kind in (_FOOTER, _DATA_END):
                break
            if kind == _CHUNK and (chunk := _checked_chunk(stream)) is not None:
                found[begin - _HEAD.size] = chunk
            try:
                stream.seek(begin + length)
            except (OSError, OverflowError, ValueError):
                break
    return found


def check_index(storage: Any, chunks: Mapping[int, Chunk]) -> None:
    """Check that the index of an MCAP file speaks of the chunks that were checked.

    Parameters
    ----------
    storage : rosbags.rosbag2.storage_mcap.McapReader
        Opened.
    chunks : mapping
        What :func:`checked_chunks` found in its file.

    Raises
    ------
    ValueError
        When the index says something else of a chunk than the chunk itself.
    """
    for entry in storage.chunks:
        stated = Chunk(entry.compression, entry.compressed_size, entry.uncompressed_size)
        if chunks.get(entry.chunk_start_offset) != stated:
            raise ValueError("an index that does not fit the chunks")


def _checked_chunk(stream: BinaryIO) -> Chunk | None:
    """Check the chunk whose content begins here; None when it is cut off."""
    head = stream.read(_CHUNK_HEAD.size)
    if len(head) < _CHUNK_HEAD.size:
        return None
    _, _, size, _, name_length = _CHUNK_HEAD.unpack(head)
    method = stream.read(min(name_length, _LONGEST_NAME)).decode("latin-1")
    n_packed = int.from_bytes(stream.read(8), "little")
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size >> 20} MB, more than {LARGEST_CHUNK >> 20} MB")
    if method in ("lz4", "zstd"):
        n_left = os.fstat(stream.fileno()).st_size - stream.tell()
        # What comes out is counted, not believed: a stream may hold more than its chunk says.
        unpacked(method, stream.read(min(n_packed, n_left)))
    return Chunk(method, n_packed, size)
