"""Compilation of loops by numba, and the cache of compiled code."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

import warnings
from hashlib import sha256
from inspect import signature
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.event import TimingListener, register
from numba.extending import overload

#: Digest of all modules with compiled functions.
_SOURCES = sha256(
    b"".join(
        path.read_bytes()
        for folder in ("linalg", "minimise", "stepping", "steady")
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


#: Adds up the time that this process spends in compilation; loading from the cache is not counted.
COMPILING = TimingListener()
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


#: References to arrays are not counted: counting takes a quarter of the time of loops that last
#: microseconds. That is safe because no compiled function makes an array, and callers keep those
#: that they pass.
_OPTIONS: Any = {"error_model": "numpy", "_nrt": False}


def _decorator(**options: Any) -> Any:
    """Decorator of functions to compile; compiled code is kept where a folder can be written."""
    options |= _OPTIONS | {"no_cfunc_wrapper": True}

    def decorate(function: Any) -> Any:
        try:
            dispatcher = njit(cache=True, **options)(function)
        except RuntimeError as error:
            _warn_once(error)
            return njit(**options)(function)
        if hasattr(dispatcher, "_cache"):  # absent where numba is set not to compile
            dispatcher._cache = _Cache(dispatcher._cache)
        return dispatcher

    return decorate


compiled = _decorator()
#: For functions that only compiled code calls: without an entry from Python they compile faster.
compiled_inside = _decorator(no_cpython_wrapper=True)
#: For parts of such functions, see `compiled_for`.
inlined = _decorator(no_cpython_wrapper=True, forceinline=True)
#: For sums over many points: the compiler may reorder them, and then uses vector instructions.
sums_in_any_order = _decorator(fastmath={"reassoc", "contract"}, no_cpython_wrapper=True)


def compiled_for(function: Any, *kinds: Any, inlined: bool = False) -> Any:
    """Decorator: implementation of a generic ``function`` for kinds of its first argument.

    Compiled code that calls ``function`` gets the implementation for the named tuple types
    ``kinds``. A call hands over each array of a named tuple by seven words, which takes a third of
    the time of small steps: functions that a loop calls are ``inlined``.
    """

    def decorate(own: Any) -> Any:
        def chosen(*arguments: Any) -> Any:
            return own if getattr(arguments[0], "instance_class", None) in kinds else None

        # numba reads the names of the arguments.
        chosen.__signature__ = signature(own)  # type: ignore[attr-defined]
        overload(function, jit_options=_OPTIONS | {"forceinline": inlined})(chosen)
        return own

    return decorate


def compiled_as(function: Any) -> Any:
    """Decorator: implementation of a Python ``function`` in compiled code, for all arguments."""

    def decorate(own: Any) -> Any:
        def chosen(*arguments: Any) -> Any:
            del arguments
            return own

        # numba reads the names of the arguments.
        chosen.__signature__ = signature(own)  # type: ignore[attr-defined]
        overload(function, jit_options=_OPTIONS)(chosen)
        return own

    return decorate
