"""What numba calls dispatchers: compiled functions, of two sorts.

An :class:`EntryFunction` is called from Python. It has machine code, which is kept on disk.

An :class:`InnerFunction` is called by other compiled functions. numba would make machine code and a wrapper for Python
of each of them, although neither is ever used: what a caller needs is the intermediate code of LLVM, which becomes part
of its own. So only that is made, and kept on disk: the next function that needs it, in this process or in another, does
not translate it again.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

from llvmlite import binding as llvm
from numba import njit, types
from numba.core import caching, errors, sigutils
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags, compile_result
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import AbstractTemplate

from pmcl.engine.disk_cache import DiskCache
from pmcl.engine.progress import announce_compilation
from pmcl.errors import ModelError

__all__ = ["EntryFunction", "InnerFunction", "call_template"]


class _Flags(Flags):
    """Compilation flags that compare fast: numba does so ten thousand times for a function, a sixth of its work.

    Flags that say the same explicitly and by default count as different. That does no harm.
    """

    __slots__ = ()

    def __hash__(self) -> int:
        return hash(frozenset(self._values))

    def __eq__(self, other: object) -> bool:
        return type(other) is _Flags and self._values == other._values


class EntryFunction(CPUDispatcher):
    """A compiled function that Python calls.

    Parameters
    ----------
    function : callable
        What to compile.
    options : dict
        How, as for ``numba.njit``.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions={"nopython": True, **options})
        self._compiler._customize_flags = _Flags
        self._cache = DiskCache(function, options, caching.CompileResultCacheImpl)

    def compile(self, sig: Any) -> Any:
        """Compile one signature, or find it on disk."""
        # Threads that start together must not compile the same thing twice: numba's lock comes first.
        with global_compiler_lock:
            if _is_known(self, sig):
                return super().compile(sig)
            file = self.file_to_come(sig)
            if file is not None or not self._cache.cache_path:
                announce_compilation(self.py_func.__name__, file)
            with self._cache.alone(file):
                return super().compile(sig)

    def file_to_come(self, signature: Any) -> Path | None:
        """Return the file that will hold the code of one signature; None where nothing has to be compiled for it."""
        return None if _is_known(self, signature) else self._cache.file_to_come(signature, self.targetctx)

    def compile_unless_busy(self, signature: Any) -> None:
        """Compile one signature unless it is on disk or another process is at it."""
        file = self.file_to_come(signature)
        if file is not None:
            with global_compiler_lock, self._cache.alone(file, patience=0.0) as needed:
                if needed:
                    super().compile(signature)


def _is_known(function: CPUDispatcher, signature: Any) -> bool:
    return tuple(sigutils.normalize_signature(signature)[0]) in function.overloads


class _InnerLibrary(CPUCodeLibrary):
    """The code of an inner function: it is linked into that of others, and never made ready to run by itself."""

    def _optimize_final_module(self) -> None:
        # Once, where all is linked together: optimised anew in every caller it would take a fifth longer.
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @classmethod
    def from_bitcode(cls, codegen: Any, name: str, bitcode: bytes) -> _InnerLibrary:
        library = cls(codegen, name)
        library._final_module = llvm.parse_bitcode(bitcode)
        library._finalize_final_module()
        return library


class _InnerPipeline(CompilerBase):
    """numba's usual passes, into an :class:`_InnerLibrary`."""

    def define_pipelines(self) -> list[Any]:
        self.state.library = _InnerLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]


def _inner_flags(flags: Flags) -> _Flags:
    inner = _Flags(flags)
    inner.no_compile = inner.no_cpython_wrapper = inner.no_cfunc_wrapper = True
    return inner


class _InnerCacheImplementation(caching.CompileResultCacheImpl):
    """Keeps the intermediate code; numba's own keeps machine code."""

    def reduce(self, data: Any) -> Any:
        library, descriptor = data.library, data.fndesc
        descriptor.typemap = descriptor.calltypes = None
        bitcode = library._final_module.as_bitcode()
        environments = tuple(data._find_referenced_environments())
        return library.name, bitcode, descriptor, data.environment, data.signature, data.reload_init, environments

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        name, bitcode, descriptor, environment, signature, reload_init, environments = payload
        for function in reload_init:
            function()
        return compile_result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            entry_point=object(),
            signature=signature,
            objectmode=False,
            lifted=(),
            fndesc=descriptor,
            library=_InnerLibrary.from_bitcode(target_context.codegen(), name, bitcode),
            environment=environment,
            reload_init=reload_init,
            referenced_envs=environments,
        )


# How numba says that a function compiled without memory management makes an array, and that it returns a part of one.
_SIGNS_OF_ALLOCATION = ("NRT required", "Only accept returning of array")


def _allocation_error(function: Callable[..., Any]) -> ModelError:
    code = function.__code__
    return ModelError(
        f"{function.__module__}.{function.__name__} ({code.co_filename}, line {code.co_firstlineno}) makes or returns "
        "an array, but was declared as a function that does not; let it fill an array that it is given, or, if it "
        "implements a function for a table, register it with allocates=True"
    )


class InnerFunction(CPUDispatcher):
    """A compiled function that other compiled functions call.

    Called from Python it is compiled once more, as any function of numba, and kept nowhere: only tests do that.

    Parameters
    ----------
    function : callable
        What to compile.
    options : dict
        How, as for ``numba.njit``.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions={"nopython": True, **options}, pipeline_class=_InnerPipeline)
        self._compiler._customize_flags = _inner_flags
        self._cache = DiskCache(function, options, _InnerCacheImplementation)

    def add_overload(self, cres: Any) -> None:
        """Remember a compilation result, but not as something to call from Python."""
        if cres.entry_point is None:
            # Just compiled. Callers find it by this object, which for other functions is what Python calls.
            cres = cres._replace(entry_point=object())
            self.targetctx.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = cres

    def compile(self, sig: Any) -> Any:
        """Compile one signature, or find it on disk."""
        with global_compiler_lock:
            if _is_known(self, sig):
                return super().compile(sig)
            with self._cache.alone(self._cache.file_to_come(sig, self.targetctx)):
                try:
                    return super().compile(sig)
                except (errors.NumbaError, TypeError) as error:
                    if self._may_not_allocate and any(sign in str(error) for sign in _SIGNS_OF_ALLOCATION):
                        raise _allocation_error(self.py_func) from None
                    raise

    @property
    def _may_not_allocate(self) -> bool:
        return self.targetoptions.get("_nrt", True) is False

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Say what a call returns; a constant is compiled for as any value of its type, not once more for itself."""
        return super().get_call_template(tuple(types.unliteral(kind) for kind in args), kws)

    @functools.cached_property
    def _for_python(self) -> Any:
        options = {name: value for name, value in self.targetoptions.items() if name != "nopython"}
        return njit(**options)(self.py_func)

    def __call__(self, *args: Any, **kws: Any) -> Any:
        """Run the function from Python."""
        return self._for_python(*args, **kws)


def call_template(function: Callable[..., Any], choose: Callable[..., InnerFunction | None]) -> type[AbstractTemplate]:
    """Return how numba types a call of `function`: ``choose(*argument types)`` says which inner function that is."""

    class Template(AbstractTemplate):
        key = function

        def generic(self, args: Any, kws: Any) -> Any:
            chosen = choose(*args)
            if chosen is None:
                return None
            kind = types.Dispatcher(chosen)
            signature: Any = kind.get_call_type(self.context, args, kws)
            self._found[signature.args] = kind.get_overload(signature)
            return signature

        def get_impl_key(self, sig: Any) -> Any:
            return self._found[sig.args]

        _found: dict[Any, Any] = {}  # noqa: RUF012  (of this class: numba makes new instances)

    Template.__name__ = f"{function.__name__}_template"
    return Template
