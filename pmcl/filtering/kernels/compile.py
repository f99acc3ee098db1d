"""Compilation: one decorator for all kernels, a disk cache that cannot go stale, dispatch on the type of a table.

Three things numba does not do by itself:

* :func:`kernel` compiles without the global interpreter lock, with division semantics of NumPy and only those
  floating-point liberties that keep NaN and infinity meaningful.
* :func:`entry` caches compiled machine code on disk. numba looks only at the file of the function itself; the key
  here also holds a hash of every kernel source and of every file that registers an implementation, so that
  a stale kernel can never run.
* :func:`generic` makes a function of which each table type has its own implementation, chosen at compile time.
  The result is one specialised loop per model, without function pointers. Called from Python it
  runs the same implementation uncompiled, which is what the tests compare with.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import pickle
import threading
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit, types
from numba.core import caching
from numba.extending import overload

from pmcl.filtering.kernels.progress import announce_compilation

__all__ = ["entry", "generic", "kernel", "overload_for_types"]

_CONTRACT = {"contract", "nsz"}
_compile_lock = threading.RLock()
_extra_sources: set[str] = set()


def _options(*, reorder: bool = False, strict: bool = False, allocates: bool = False) -> Any:
    flags = set() if strict else set(_CONTRACT)
    if reorder:
        flags |= {"reassoc"}
    # Nothing here is called from C: that wrapper alone would be a tenth of the compilation time.
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": flags, "no_cfunc_wrapper": True}
    if not allocates:
        # Without reference counting: each atomic count of an array view costs as much as ten particles.
        options["_nrt"] = False
    return options


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    reorder: bool = False,
    strict: bool = False,
) -> Any:
    """Compile a function that is called from other kernels and allocates nothing.

    Parameters
    ----------
    function : callable
        The function; may be left out when options are given.
    reorder : bool
        Sums may be reordered (needed to vectorise a reduction).
    strict : bool
        Every operation is rounded as written: products and sums are not fused.
    """
    if function is None:
        return functools.partial(kernel, reorder=reorder, strict=strict)
    return njit(**_options(reorder=reorder, strict=strict))(function)


@functools.cache
def _package_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode() + path.read_bytes())
    for path in sorted((Path(__file__).parents[2] / "models").glob("*tables.py")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _source_hash() -> str:
    digest = hashlib.sha256(_package_hash().encode())
    for name in sorted(_extra_sources):
        digest.update(name.encode())
        with contextlib.suppress(OSError):
            digest.update(Path(name).read_bytes())
    return digest.hexdigest()


# What reading an index raises when it names a table type that this process cannot import.
_FOREIGN = (ImportError, AttributeError, pickle.UnpicklingError)


class _CacheFiles(caching.IndexDataCacheFile):
    """numba's index and code files, with a name of its own for each piece of code.

    numba numbers them and writes the index first: of two processes that compile one function for different models at
    the same time both may take the same number, and the index of one then names the machine code of the other.
    """

    def save(self, key: Any, data: Any) -> None:
        stem = self._index_name.removesuffix(".nbi")
        name = self._load_index().get(key) or f"{stem}.{uuid.uuid4().hex[:16]}.nbc"
        self._save_data(name, data)
        self._save_index(self._load_index() | {key: name})


class _SourceKeyedCache(caching.FunctionCache):
    """numba's function cache with the hash of all sources in the key, and an index of its own for each hash.

    numba keeps one index per function, which names all table types ever compiled for. A process that cannot import a
    user's types would fail to read it; such an index is as good as none.
    """

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), _source_hash())

    def _choose_index(self) -> None:
        self._cache_file = _CacheFiles(
            cache_path=self._cache_path,
            filename_base=f"{self._impl.filename_base}.{_source_hash()[:12]}",
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        self._choose_index()
        try:
            return super().load_overload(sig, target_context)
        except _FOREIGN:
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        self._choose_index()
        try:
            super().save_overload(sig, data)
        except _FOREIGN:
            self.flush()
            super().save_overload(sig, data)


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, and keep its machine code on disk.

    The code lies beside the package (or in the user's cache folder, or where ``NUMBA_CACHE_DIR`` says).
    Where none can be written, it is compiled anew in each process. The first compilation is announced.
    """
    compiled = njit(**_options(allocates=True))(function)
    with contextlib.suppress(RuntimeError):  # numba: "no locator available"
        compiled._cache = _SourceKeyedCache(function)

    original = compiled._compile_for_args

    def compile_once(*arguments: Any, **keywords: Any) -> Any:
        # Threads that start together must not compile the same thing twice.
        with _compile_lock, announce_compilation(function.__name__, compiled):
            return original(*arguments, **keywords)

    compiled._compile_for_args = compile_once
    return compiled


def generic(prototype: Callable[..., Any]) -> Any:
    """Make a function that each table type implements for itself.

    Parameters
    ----------
    prototype : callable
        Its signature and docstring are the contract; its body is never run.

    Returns
    -------
    callable
        With the attribute ``register(TableType, allocates=True)``, a decorator for implementations: plain
        functions that numba can compile; those that make no arrays say ``allocates=False`` and run faster.
        An implementation for ``object`` serves all types that have none of their own.
        From Python the call goes to the implementation uncompiled.
    """
    implementations: dict[type, Callable[..., Any]] = {}

    @functools.wraps(prototype)
    def dispatch(*arguments: Any) -> Any:
        try:
            implementation = implementations.get(type(arguments[0])) or implementations[object]
        except KeyError:
            known = ", ".join(sorted(kind.__name__ for kind in implementations))
            raise TypeError(
                f"{prototype.__name__} has no implementation for a table of type "
                f"{type(arguments[0]).__name__} (it has: {known}); register one"
            ) from None
        return implementation(*arguments)

    parameters = ", ".join(inspect.signature(prototype).parameters)
    first = parameters.split(",")[0]

    def register(table_type: type, *, allocates: bool = True) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def decorate(implementation: Callable[..., Any]) -> Callable[..., Any]:
            implementations[table_type] = implementation
            _remember_source(implementation)

            def choose(table: Any) -> Callable[..., Any] | None:
                if not isinstance(table, types.NamedTuple | types.NamedUniTuple):
                    return None
                kind = table.instance_class
                if kind is table_type or (table_type is object and kind not in implementations):
                    return implementations[table_type]
                return None

            # numba wants the typing function to have the parameters of the implementation.
            scope: dict[str, Any] = {"choose": choose}
            exec(f"def typing({parameters}):\n    return choose({first})", scope)
            overload(dispatch, jit_options=_options(allocates=allocates), strict=False)(scope["typing"])
            return implementation

        return decorate

    dispatch.register = register  # type: ignore[attr-defined]
    dispatch.implementations = implementations  # type: ignore[attr-defined]
    return dispatch


def overload_for_types(function: Callable[..., Any]) -> Any:
    """Decorate a typing function that chooses an allocation-free implementation of `function` by argument types."""
    return overload(function, jit_options=_options())


def _remember_source(implementation: Callable[..., Any]) -> None:
    with contextlib.suppress(TypeError):
        source = inspect.getsourcefile(implementation)
        if source and Path(source).resolve().parent != Path(__file__).resolve().parent:
            _extra_sources.add(source)
