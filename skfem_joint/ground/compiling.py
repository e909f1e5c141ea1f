"""Compilation of loops by numba, and the cache of compiled code.

numba optimises each compiled function with all that it calls, and writes machine code of it. In a
nest of five levels the innermost function goes through both five times. Here only what Python calls
is optimised and written, once: `compiled` functions. What they call are parts, which are translated
and no more; they are not kept either, because a function that is kept holds its parts. The first
run of a bar, full and reduced, compiles in two fifths of the time.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

import gc
import warnings
from functools import update_wrapper
from hashlib import sha256
from inspect import signature
from pathlib import Path
from typing import Any

from llvmlite.binding import create_pass_builder, create_pipeline_tuning_options
from numba import njit, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.event import TimingListener, register
from numba.extending import overload, typeof_impl

#: Digest of all modules with compiled functions.
_SOURCES = sha256(
    b"".join(
        path.read_bytes()
        for folder in ("linalg", "minimise", "stepping", "steady", "harmonic")
        for path in sorted((Path(__file__).parent.parent / folder).glob("*.py"))
    )
).hexdigest()
_warned: list[str] = []


def _warn_once(reason: object) -> None:
    """Warn, once in a process, that compiled code cannot be kept."""
    if not _warned:
        _warned.append(str(reason))
        warnings.warn(
            f"compiled code cannot be kept ({reason}): every new process compiles it again, which "
            "takes up to half a minute; set NUMBA_CACHE_DIR to a folder that can be written to",
            RuntimeWarning,
            stacklevel=3,
        )


class _Compiling(TimingListener):
    """Time spent in compilation, in which garbage is not collected: looking for it takes a sixth.

    Attributes
    ----------
    count : int
        Compilations up to now.
    """

    def __init__(self) -> None:
        super().__init__()
        self.count, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """Stop the collector where the outermost compilation begins."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self.count += 1
        super().on_start(event)

    def on_end(self, event: Any) -> None:
        """Go on collecting where it ends."""
        super().on_end(event)
        if self._depth == 0 and self._collects:
            gc.enable()


#: Of all compilations of this process; loading from the cache is not counted.
COMPILING = _Compiling()
register("numba:compile", COMPILING)


class _Cache:
    """numba's cache of a function, which renews damaged files and does without a full disk.

    For numba compiled code is current while the file of the function itself is unchanged. Here all
    files with compiled functions count, because a compiled function contains those that it calls.
    """

    def __init__(self, own: Any) -> None:
        self._own = own
        files = own._cache_file
        files._source_stamp = (files._source_stamp, _SOURCES)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._own, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        try:
            return self._own.load_overload(signature, context)
        except Exception:  # noqa: BLE001 - any error of a damaged file: compile anew
            try:
                self._own.flush()
            except OSError:
                self._own.disable()
            return None

    def save_overload(self, signature: Any, compiled_code: Any) -> None:
        try:
            self._own.save_overload(signature, compiled_code)
        except OSError as error:
            self._own.disable()
            _warn_once(error)


def _link(library: Any, module: Any) -> None:
    """Add a module to a library as it is: numba would optimise it on its own first."""
    module.data_layout = library._codegen._data_layout
    library._final_module.link_in(module)


class _Part(JITCodeLibrary):
    """Code of a part: neither optimised nor made machine code, which its callers are.

    Its environment, by which compiled code reaches objects of Python, is not set: no part needs it.
    """

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Part of what numba takes for its generator of code."""

    def add_llvm_module(self, module: Any) -> None:
        _link(self, module)

    def finalize(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


class _Whole(JITCodeLibrary):
    """Code of a function that Python calls, with all of its parts.

    Loops are short here, of tens to hundreds of numbers: loops that are not unrolled, beyond one
    vector instruction at a time, are as fast, and take half as long to compile.
    """

    def add_linking_library(self, library: Any) -> None:
        if library in self._linking_libraries:
            return
        super().add_linking_library(library)
        if isinstance(library, _Part):
            for other in library._linking_libraries:
                self.add_linking_library(other)

    def add_llvm_module(self, module: Any) -> None:
        _link(self, module)

    def _optimize_final_module(self) -> None:
        tuning = create_pipeline_tuning_options()
        tuning.speed_level = 3
        tuning.loop_vectorization = True
        tuning.slp_vectorization = tuning.loop_unrolling = tuning.loop_interleaving = False
        passes = create_pass_builder(self._codegen._tm, tuning)
        passes.getModulePassManager().run(self._final_module, passes)


class _Options(Flags):
    """Options of a compilation, which are equal where the same ones are set alike.

    numba itself compares the values of all options, in tens of thousands of look-ups.
    """

    def __hash__(self) -> int:
        return hash(frozenset(self._values))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Options) and bool(self._values == other._values)


class _Compiler(CompilerBase):
    """numba's compiler, with a library of code of our own."""

    library: Any

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags = _Options(self.state.flags)

    def define_pipelines(self) -> Any:
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()  # the cache of functions asks it for machine code
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class _CompilerOfParts(_Compiler):
    library = _Part


class _CompilerOfWholes(_Compiler):
    library = _Whole


#: References to arrays are not counted: counting takes a quarter of the time of loops that last
#: microseconds. That is safe because no compiled function makes an array, and callers keep those
#: that they pass.
_OPTIONS: Any = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}
_OF_PARTS: Any = _OPTIONS | {"no_cpython_wrapper": True, "pipeline_class": _CompilerOfParts}


def _kept(function: Any) -> Any:
    """Function that Python calls; its compiled code is kept where a folder can be written."""
    options = _OPTIONS | {"pipeline_class": _CompilerOfWholes}
    try:
        dispatcher = njit(cache=True, **options)(function)
    except RuntimeError as error:
        _warn_once(error)
        return njit(**options)(function)
    if hasattr(dispatcher, "_cache"):  # absent where numba is set not to compile
        dispatcher._cache = _Cache(dispatcher._cache)
    return dispatcher


class compiled:  # noqa: N801 - a decorator
    """Decorator: function that Python may call. In other compiled functions it is a part.

    Attributes
    ----------
    entry, inside : Dispatcher
        What Python calls, and what compiled functions call. Each is compiled when it is called.
    """

    def __init__(self, function: Any) -> None:
        update_wrapper(self, function)
        self.entry, self.inside = _kept(function), compiled_inside(function)

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        return self.entry(*arguments)


@typeof_impl.register(compiled)
def _type_of_compiled(value: compiled, context: Any) -> Any:
    return types.Dispatcher(value.inside)


#: For functions that only compiled code calls.
compiled_inside = njit(**_OF_PARTS)
#: For small ones, see `compiled_for`.
inlined = njit(forceinline=True, **_OF_PARTS)
#: For sums over many points: the compiler may reorder them, and then uses vector instructions.
sums_in_any_order = njit(fastmath={"reassoc", "contract"}, **_OF_PARTS)


def compiled_for(function: Any, *kinds: Any, inlined: bool = False) -> Any:
    """Decorator: implementation of a generic ``function`` for kinds of its first argument.

    Compiled code that calls ``function`` gets the implementation for the named tuple types
    ``kinds``, or for all arguments if there are none. A call hands over each array of a named tuple
    by seven words, which takes a third of the time of small steps: functions that a loop calls are
    ``inlined``.
    """

    def decorate(own: Any) -> Any:
        def chosen(*arguments: Any) -> Any:
            kind = getattr(arguments[0], "instance_class", None) if kinds else None
            return own if not kinds or kind in kinds else None

        # numba reads the names of the arguments.
        chosen.__signature__ = signature(own)  # type: ignore[attr-defined]
        overload(function, jit_options=_OF_PARTS | {"forceinline": inlined})(chosen)
        return own

    return decorate


#: Decorator: implementation of a Python ``function`` in compiled code, for all arguments.
compiled_as = compiled_for
