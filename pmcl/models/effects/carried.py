"""Effects of the user's own files, carried to other processes.

Their functions are pickled by the name of their module, so the file must go along.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

__all__ = ["EffectFile", "carried_effects", "remember_file", "restore_effects"]


class EffectFile(NamedTuple):
    """A file with effects.

    Attributes
    ----------
    module : str
        Name of the module that it was run as.
    file : str
        Its path, for messages.
    source : bytes
        Its content.
    """

    module: str
    file: str
    source: bytes


_files: dict[str, EffectFile] = {}
_lock = threading.Lock()


def remember_file(module: str, file: Path, source: bytes) -> None:
    """Note that a file was run as a module of this name."""
    _files[module] = EffectFile(module, str(file), source)


def carried_effects() -> tuple[EffectFile, ...]:
    """Return the files with effects that this process has read."""
    return tuple(_files.values())


def restore_effects(files: tuple[EffectFile, ...]) -> None:
    """Run files with effects, unless this process has read the same already.

    Parameters
    ----------
    files : tuple of EffectFile
        From :func:`carried_effects` of another process, in which they ran without an error.
    """
    with _lock:
        for carried in files:
            known = _files.get(carried.module)
            if known is not None and known.source == carried.source:
                continue
            module = ModuleType(carried.module)
            module.__file__ = carried.file
            sys.modules[carried.module] = module
            exec(compile(carried.source, carried.file, "exec"), vars(module))
            _files[carried.module] = carried
