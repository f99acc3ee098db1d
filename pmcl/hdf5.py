"""Files of HDF5 from strangers: looked through before anything in them is read.

NetCDF-4 files (logs, posteriors, tracks) and checkpoints are HDF5. HDF5 follows what a file says about where its data
are: in another file, by an external link, a virtual data set or external raw storage. So a log could make pmcl read any
file of this machine, and its bytes would travel on into what is written and shared. It also lets a small file declare
arrays of any size, filled with one number or compressed to nothing. None of this has a use in files that pmcl reads.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

__all__ = ["MOST_BYTES", "MOST_IN_GROUP", "StoredArray", "UnsafeFileError", "stored_arrays"]

MOST_BYTES = 2**30
"""The greatest size of all arrays of a posterior in memory [byte]; a log may have less."""

MOST_IN_GROUP = 1000
"""The greatest number of variables in a group. A posterior of a hundred logs has some hundred in each of its groups.
xarray takes a time that grows with the square of their number: 5 s for a thousand."""

# Arrays may be larger in memory than in their file by this factor, since compression makes chains that do not move very
# small; and all of them by this many bytes in any case.
_LARGEST_RATIO, _FREE_BYTES = 100, 64 * 2**20
# How many groups there may be, and how deep.
_MOST_GROUPS, _DEEPEST = 100, 10


class UnsafeFileError(ValueError):
    """A file points outside itself, in circles, or declares far more than it holds; the message says what came."""


class StoredArray(NamedTuple):
    """An array in a file.

    Attributes
    ----------
    shape : tuple of int
        Declared shape.
    n_bytes : int
        How large it would be in memory [byte]; of texts, only what refers to them counts.
    """

    shape: tuple[int, ...]
    n_bytes: int


def stored_arrays(path: str | os.PathLike[str]) -> dict[str, StoredArray]:
    """Look through a file of HDF5; nothing is followed, and no array is read.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    dict of str to StoredArray
        By their full names, such as ``/posterior/sigma_turn``.

    Raises
    ------
    UnsafeFileError
        When it is a pipe or a device, a link or an array lies elsewhere, groups contain each other, or far more is
        declared than stored.
    OSError
        When it is no file of HDF5. Damaged files raise errors of nearly any kind.
    """
    import h5py

    if os.path.exists(path) and not os.path.isfile(path):
        # A pipe that nobody writes to would be waited for without end.
        raise UnsafeFileError("something that is no file")
    with h5py.File(path, "r") as file:
        found = dict(_arrays_of(file))
        stored = {name: int(file[name].id.get_storage_size()) for name in found}
    declared, held = sum(array.n_bytes for array in found.values()), sum(stored.values())
    if declared > _FREE_BYTES + _LARGEST_RATIO * held:
        name, largest = max(found.items(), key=lambda item: item[1].n_bytes)
        raise UnsafeFileError(
            f"arrays of {_size(declared)} in {_size(held)} of data, such as '{name}' of shape {_shape(largest.shape)}"
        )
    return found


def _arrays_of(file: Any) -> Iterator[tuple[str, StoredArray]]:
    """Go through all groups of a file, each once."""
    import h5py

    # Hard links may make a group contain itself; its address in the file tells.
    known = {h5py.h5o.get_info(file.id).addr}
    groups = [("", file, 0)]
    while groups:
        place, group, depth = groups.pop()
        if len(group) > MOST_IN_GROUP:
            raise UnsafeFileError(f"{len(group)} variables in '{place or '/'}', more than {MOST_IN_GROUP}")
        for key in group:
            name = f"{place}/{key}"
            link = group.get(key, getlink=True)
            if isinstance(link, h5py.ExternalLink):
                raise UnsafeFileError(f"a link '{name}' to another file, {link.filename!r:.60}")
            if isinstance(link, h5py.SoftLink):
                raise UnsafeFileError(f"a link '{name}' to another place, {link.path!r:.60}")
            item = group.get(key)
            if isinstance(item, h5py.Group):
                address = h5py.h5o.get_info(item.id).addr
                if address in known or depth == _DEEPEST or len(known) > _MOST_GROUPS:
                    raise UnsafeFileError(f"a group '{name}' within itself, or too many groups")
                known.add(address)
                groups.append((name, item, depth + 1))
            elif isinstance(item, h5py.Dataset):
                yield name, _checked(name, item)


def _checked(name: str, dataset: Any) -> StoredArray:
    # Asked for by the properties with which the array was created: h5py's own attributes follow the sources.
    properties = dataset.id.get_create_plist()
    if dataset.is_virtual:
        raise UnsafeFileError(f"an array '{name}' that is put together from other files")
    if properties.get_external_count():
        outside = properties.get_external(0)[0].decode("utf-8", errors="replace")
        raise UnsafeFileError(f"an array '{name}' whose data are in another file, {outside!r:.60}")
    shape = tuple(int(size) for size in dataset.shape or ())
    return StoredArray(shape, math.prod(shape) * int(dataset.id.get_type().get_size()))


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 2**20:.3g} MB"


def _shape(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) or "one number"
