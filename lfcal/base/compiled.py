"""Kernels that numba compiles when they are first called.

Loading numba takes longer than loading the rest of the library, so a kernel is an ordinary function until it is
needed; packages can then import their modules plainly.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

__all__ = ["Kernel", "njit", "preparing_seconds"]

P = ParamSpec("P")
R = TypeVar("R")

_LOCK = threading.RLock()


class _Spent(threading.local):
    """What this thread spent on loading and compiling kernels (CPU-seconds), and whether it is at it."""

    seconds = 0.0
    busy = False


_SPENT = _Spent()


def preparing_seconds() -> float:
    """Return the CPU-seconds that this thread has spent on loading numba, and on loading and compiling kernels.

    Work that is timed to foretell more of it takes the difference off: kernels are prepared once in a process.
    """
    return _SPENT.seconds


@contextmanager
def _preparing() -> Iterator[None]:
    """Count the CPU time of the block; a kernel that is compiled for another one is counted once."""
    if _SPENT.busy:
        yield
        return
    start, _SPENT.busy = time.thread_time(), True
    try:
        yield
    finally:
        _SPENT.seconds += time.thread_time() - start
        _SPENT.busy = False


class Kernel(Generic[P, R]):
    """A Python function and, from its first call on, its compiled form.

    Parameters
    ----------
    function
        What is compiled; it may call other kernels by their names in its module.
    options
        Those of `numba.njit`.
    """

    def __init__(self, function: Callable[P, R], options: dict[str, object]) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._options = options
        self._compiled: Any = None

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the compiled function."""
        result: R = (self._compiled or self.compiled())(*args, **kwargs)
        return result

    def compiled(self) -> Any:
        """Return numba's own object for this kernel."""
        with _LOCK, _preparing():
            if self._compiled is None:
                import numba

                # compiled code finds the kernels it calls among the names of its module, where numba
                # understands its own objects only.
                names = self.function.__globals__
                for name in self.function.__code__.co_names:
                    called = names.get(name)
                    if isinstance(called, Kernel):
                        names[name] = called.compiled()
                made = numba.njit(**self._options)(self.function)
                _drop_unreadable_cache(made)
                _save_code_before_index(made)
                _drop_unreadable_code(made)
                _run_without_cache(made)
                _clock(made)
                self._compiled = made
            return self._compiled


def _drop_unreadable_cache(dispatcher: Any) -> None:
    """Empty a kernel's cache on disk where its index does not load.

    An index of an earlier version may name a record that was renamed since. numba unpickles it before it looks whether
    the source has changed, and would fail at every call.
    """
    file = _cache_file(dispatcher)
    if file is None:
        return
    try:
        file._load_index()
    except Exception:  # whatever unpickling an old index may raise
        with suppress(OSError):
            file.flush()


def _save_code_before_index(dispatcher: Any) -> None:
    """Let a kernel's index on disk name only what is there, whatever other processes save at the same time.

    numba writes the index first and the code after it, under the next free number: until it is there, a process that
    loads the index runs what an earlier version of the source left under that number; and of two processes that save
    for unlike arguments at once, one may find the other's code under its own. A name that follows from the source and
    the arguments, and the other order, leave no such moment: at worst an entry is lost, and compiled again.
    """
    file = _cache_file(dispatcher)
    if file is None:
        return

    def save(key: Any, data: Any) -> None:
        # the same name for the same code only, whatever else this process does with random numbers
        digest = hashlib.sha256(repr((file._source_stamp, key)).encode()).digest()
        name = file._data_name(int.from_bytes(digest[:8], "big"))
        file._save_data(name, data)
        entries = file._load_index()
        if not entries:  # of an earlier version, or none: nothing refers to what lies there
            _clear(Path(file._data_path(name)))
        file._save_index({**entries, key: name})

    file.save = save


def _cache_file(dispatcher: Any) -> Any:
    """Return numba's cache of a kernel on disk; None where it has none."""
    return getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)


def _drop_unreadable_code(dispatcher: Any) -> None:
    """Let a kernel be compiled again where its code on disk does not load, or is that of other arguments."""
    cache: Any = getattr(dispatcher, "_cache", None)
    if not hasattr(cache, "load_overload"):
        return
    load = cache.load_overload

    def load_if_right(signature: Any, target: Any) -> Any:
        try:
            found = load(signature, target)
        except Exception:  # whatever unpickling damaged code may raise
            return None
        arguments = getattr(signature, "args", signature)
        return found if found is not None and tuple(found.signature.args) == tuple(arguments) else None

    cache.load_overload = load_if_right


def _clear(kept: Path) -> None:
    """Remove the code of a kernel from the disk but one file; what another process has just saved it saves again."""
    base = kept.name.split(".nbc")[0].rpartition(".")[0]
    for path in kept.parent.glob(f"{glob.escape(base)}.*.nbc"):
        if path != kept:
            with suppress(OSError):
                path.unlink()


def _run_without_cache(dispatcher: Any) -> None:
    """Let a kernel run where what was compiled cannot be kept: on a full disk it is compiled again the next time."""
    cache: Any = getattr(dispatcher, "_cache", None)
    if not hasattr(cache, "save_overload"):
        return
    save = cache.save_overload

    def save_if_possible(signature: Any, data: Any) -> None:
        with suppress(OSError):
            save(signature, data)

    cache.save_overload = save_if_possible


def _clock(dispatcher: Any) -> None:
    """Count the time that numba spends on a kernel for each new kind of arguments: from the disk, or compiling."""
    compile_for = dispatcher.compile

    def counted(signature: Any) -> Any:
        with _preparing():
            return compile_for(signature)

    dispatcher.compile = counted


def njit(**options: object) -> Callable[[Callable[P, R]], Kernel[P, R]]:
    """Compile the decorated function at its first call: cached on disk, without the GIL, typed for mypy."""
    settings = {"cache": True, "nogil": True, **options}
    return lambda function: Kernel(function, settings)
