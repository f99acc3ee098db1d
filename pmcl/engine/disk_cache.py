"""Compiled code on disk: one file for each function and signature, named after everything that it depends on.

numba keeps an index for each function and looks only at the file of that function. Here the name of a file holds a hash
of every source that compiled code may come from, so that stale code can never run. There is no index that two processes
could overwrite for each other, or that names the types of a model which this process cannot import.

A process that compiles a function locks its file; others that want the same function wait and then read it.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import os
import pickle
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core import caching
from numba.core.serialize import dumps

from pmcl.engine.file_lock import FileLock

__all__ = ["DiskCache", "current_sources", "kernel_modules", "remember_source"]

# After so long [s] another process that compiles the same function is taken to hang, and is not waited for any longer.
_PATIENCE = 120.0
_PAUSE = 0.02

_HOME = Path(__file__).resolve().parents[1]
# Where compiled code and the tables that it reads are written, below the package's folder.
_OWN_SOURCES = ("engine/*.py", "filtering/kernels/**/*.py", "filtering/reading_information.py",
                "models/**/kernels/**/*.py", "models/**/kernels.py", "models/**/table*.py", "models/sensors/discs.py",
)  # fmt: skip
# Of each other source that holds kernels: a hash of its content.
_extra_sources: dict[str, str] = {}
# The types of tables, or of their extras, that have an implementation in one of those; `object` where one serves all.
_extra_types: set[str] = set()
# The modules that hold kernels, pmcl's own and others, in the order in which they were imported.
_kernel_modules: dict[str, None] = {}


def remember_source(function: Callable[..., Any], implements_for: type | None = None) -> None:
    """Let compiled code depend on the file that `function` is written in, as it is now.

    Parameters
    ----------
    function : callable
        A function that is compiled.
    implements_for : type, optional
        The type of tables, or of extras where it is for those alone, that it is an implementation for.
    """
    _kernel_modules[function.__module__] = None
    with contextlib.suppress(TypeError):
        name = inspect.getsourcefile(function)
        if name and not _is_own(name):
            content = b""
            with contextlib.suppress(OSError):
                content = Path(name).read_bytes()
            _extra_sources[name] = hashlib.sha256(content).hexdigest()
            if implements_for is not None:
                _extra_types.add(_name_of(implements_for))


@functools.cache
def _own_sources() -> tuple[Path, ...]:
    return tuple(sorted({path for pattern in _OWN_SOURCES for path in _HOME.glob(pattern)}))


@functools.cache
def _is_own(name: str) -> bool:
    return Path(name).resolve() in _own_sources()


def kernel_modules() -> list[str]:
    """Return the modules that hold kernels, in the order in which this process imported them.

    Another process that compiles the same functions imports all of them: an implementation for a type of tables that
    has not registered itself would be left out of what it compiles.
    """
    return list(_kernel_modules)


@functools.cache
def _package_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in _own_sources():
        digest.update(path.relative_to(_HOME).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def current_sources() -> str:
    """Return a hash of all sources that compiled code may come from."""
    extra = sorted(_extra_sources.items())
    return hashlib.sha256(repr((_package_hash(), extra)).encode()).hexdigest()


def _name_of(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _table_types(kind: Any) -> Iterator[str]:
    """Name the table types in a numba type with their modules: its own name says only what they are called."""
    if isinstance(kind, types.NamedTuple | types.NamedUniTuple):
        yield _name_of(kind.instance_class)
    if isinstance(kind, types.BaseTuple):
        for part in kind.types:
            yield from _table_types(part)


def _is_extra(table_type: str) -> bool:
    return not table_type.startswith(f"{_HOME.name}.") or table_type in _extra_types


class DiskCache(caching._Cache):
    """What numba asks for the compiled code of one function.

    Parameters
    ----------
    function : callable
        The function in Python.
    options : dict
        How it is compiled.
    implementation : type
        A numba ``CacheImpl``: how a compilation result is turned into something to pickle, and back.

    Notes
    -----
    The files lie beside the package, or in the user's cache folder, or where ``NUMBA_CACHE_DIR`` says. Where none can
    be written, nothing is kept and every process compiles anew.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any], implementation: Any) -> None:
        self._function, self._make = function, implementation
        # Sets have another order in each process.
        plain = {name: sorted(value) if isinstance(value, set) else value for name, value in options.items()}
        self._options = repr(sorted(plain.items()))

    @functools.cached_property
    def _implementation(self) -> Any:
        # numba: "no locator available", or a function without a file.
        try:
            return self._make(self._function)
        except (RuntimeError, OSError, TypeError):
            return None

    @property
    def cache_path(self) -> Any:
        """Folder of the files; None where nothing is kept."""
        return self._implementation and self._implementation.locator.get_cache_path()

    def enable(self) -> None:
        """Do nothing: the cache is always in use."""

    def disable(self) -> None:
        """Do nothing: the cache is always in use."""

    def flush(self) -> None:
        """Do nothing: files of other signatures and other sources do no harm."""

    def file_of(self, signature: Any, codegen: Any) -> Path:
        """Return the file of one signature; its name depends on all that the code depends on."""
        code, cells = self._function.__code__, self._function.__closure__
        tables = [name for kind in _arguments(signature) for name in _table_types(kind)]
        key = (
            str(signature),
            tables,
            codegen.magic_tuple(),
            self._options,
            hashlib.sha256(code.co_code).hexdigest(),
            hashlib.sha256(dumps(tuple(cell.cell_contents for cell in cells)) if cells else b"").hexdigest(),
            self._sources(tables),
        )
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:24]
        return Path(self.cache_path) / f"{self._implementation.filename_base}.{digest}.nbc"

    def _sources(self, tables: list[str]) -> str:
        """Return a hash of the sources that this function may call for such tables.

        Implementations are found by the types of tables: pmcl's own functions reach none of another source as long as
        all tables are pmcl's own and no other source implements anything for them. So whoever has a sensor or motion of
        their own does not compile all of pmcl's once more.
        """
        if self._is_own and _name_of(object) not in _extra_types and not any(map(_is_extra, tables)):
            return _package_hash()
        return current_sources()

    @functools.cached_property
    def _is_own(self) -> bool:
        try:
            name = inspect.getsourcefile(self._function)
        except TypeError:
            return False
        return name is not None and _is_own(name)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compilation result of one signature, or None."""
        target_context.refresh()
        if self._implementation is None:
            return None
        try:
            payload = pickle.loads(self.file_of(sig, target_context.codegen()).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            # Not there, or damaged by a crash of the machine: it will be compiled and written anew.
            return None
        return self._implementation.rebuild(target_context, payload)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the compilation result `data` of one signature, where that is possible."""
        if self._implementation is None or not self._implementation.check_cachable(data):
            return
        file = self.file_of(sig, data.target_context.codegen())
        # Written apart and then renamed: a reader finds all of it or nothing.
        draft = file.with_name(f"{file.name}.{uuid.uuid4().hex[:16]}")
        content = dumps(self._implementation.reduce(data))
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            draft.write_bytes(content)
            os.replace(draft, file)
        except OSError:
            # A full or read-only disk, or a virus scanner: then the next process compiles again.
            with contextlib.suppress(OSError):
                draft.unlink()

    def file_to_come(self, signature: Any, target_context: Any) -> Path | None:
        """Return the file that will hold the code of one signature; None where it is there, or nothing is kept."""
        target_context.refresh()
        if self._implementation is None:
            return None
        file = self.file_of(signature, target_context.codegen())
        return None if file.exists() else file

    @contextlib.contextmanager
    def alone(self, file: Path | None, *, patience: float = _PATIENCE) -> Iterator[bool]:
        """Wait while another process makes a file, and let others wait while this one does.

        Parameters
        ----------
        file : Path or None
            The file, from :meth:`file_to_come`; None locks nothing.
        patience : float
            How long to wait [s].

        Yields
        ------
        bool
            Whether the file still has to be made and no other process is known to be at it.
        """
        if file is None:
            yield True
            return
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(file.with_name(file.name + ".lock")) as lock:
            started = time.monotonic()
            mine = lock.acquire()
            while not (mine or file.exists()) and time.monotonic() - started < patience:
                time.sleep(_PAUSE)
                mine = lock.acquire()
            yield mine and not file.exists()


def _arguments(signature: Any) -> Any:
    return getattr(signature, "args", signature)
