"""Kernels that numba compiles when they are first called.

Loading numba takes longer than loading the rest of the library. A kernel is therefore an ordinary function until it is
needed, and packages can import their modules normally.
"""

from __future__ import annotations

import functools
import gc
import glob
import hashlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, ParamSpec, TypeVar

if TYPE_CHECKING:
    from numpy.typing import NDArray

from lfcal.base.notes import note

__all__ = [
    "Kernel",
    "kernel_folder",
    "kernel_input",
    "kernel_spared",
    "kernels_spared",
    "njit",
    "preparing_seconds",
    "sparing_kernels",
]

P = ParamSpec("P")
R = TypeVar("R")

_LOCK = threading.RLock()

NOTED_AFTER = 0.5
"""Processor time (s) that a process spends on compiling until a note at a terminal explains the wait."""


SPARED_S = 0.5
"""Processor time (s) that a command may lose by doing work without a kernel, before it compiles the kernel."""

_SPARED: dict[tuple[str, str], float] | None = None
"""Processor time (s) lost so far, by module and name of the kernel; None: kernels are always compiled."""

_KEPT: dict[tuple[str, str], bool] = {}
"""Whether a kernel has been compiled by this process or an earlier one; the keys are module and name of the kernel."""


class _Spent(threading.local):
    """State of a thread: its CPU time (s) for loading and compiling kernels, and what it is doing now."""

    seconds = 0.0  # loading included
    compiling = 0.0
    busy = False
    interpreting = False


_SPENT = _Spent()


def preparing_seconds() -> float:
    """Return the CPU time (s) that this thread has spent on loading numba, and on loading and compiling kernels.

    Forecasts subtract the increase of this time during a timed sample, because a process prepares its kernels only
    once.
    """
    return _SPENT.seconds


@contextmanager
def _preparing() -> Iterator[None]:
    """Add the CPU time of the block to the thread's total; nested calls are counted once.

    Python's search for unreachable objects is paused. Compiling creates so many objects that it would take a quarter of
    the time.
    """
    if _SPENT.busy:
        yield
        return
    start, _SPENT.busy = time.thread_time(), True
    paused = gc.isenabled()
    if paused:
        gc.disable()
    try:
        yield
    finally:
        if paused:
            gc.enable()
        _SPENT.seconds += time.thread_time() - start
        _SPENT.busy = False


class Kernel(Generic[P, R]):
    """A Python function that is compiled when it is first called.

    Parameters
    ----------
    function
        Function to compile; it may call other kernels by their names in its module.
    options
        Options of `numba.njit`.
    """

    def __init__(self, function: Callable[P, R], options: dict[str, object]) -> None:
        functools.update_wrapper(self, function)
        self.function = function
        self._options = options
        self._compiled: Any = None

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the compiled function, or the Python function if the kernel is called by one that runs uncompiled."""
        if _SPENT.interpreting:
            return self.function(*args, **kwargs)
        result: R = (self._compiled or self.compiled())(*args, **kwargs)
        return result

    def spared(self, seconds: float) -> bool:
        """Return whether to do work without this kernel; see `kernel_spared`."""
        return kernel_spared(self.__module__, self.function.__qualname__, seconds)

    def for_work(self, seconds: float) -> Callable[P, R]:
        """Return this kernel, or a function that runs it uncompiled if it is spared.

        ``seconds`` is an estimate of the CPU time (s) that the uncompiled function would take.
        """
        return self._interpreted if self.spared(seconds) else self

    def _interpreted(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Run the function, and the kernels that it calls, without compiling them."""
        before, _SPENT.interpreting = _SPENT.interpreting, True
        try:
            return self.function(*args, **kwargs)
        finally:
            _SPENT.interpreting = before

    def compiled(self) -> Any:
        """Return the numba function of this kernel, and compile or load it at the first call."""
        with _LOCK, _preparing():
            if self._compiled is None:
                import numba

                # compiled code looks up the kernels that it calls in its module, where numba
                # accepts only numba objects
                names = self.function.__globals__
                for name in self.function.__code__.co_names:
                    called = names.get(name)
                    if isinstance(called, Kernel):
                        names[name] = called.compiled()
                made = _made(numba, self.function, self._options)
                _drop_unreadable_cache(made)
                _save_code_before_index(made)
                _drop_unreadable_code(made)
                _run_without_cache(made)
                _clock(made)
                self._compiled = made
                _KEPT[self.__module__, self.function.__qualname__] = True
            return self._compiled


@contextmanager
def sparing_kernels() -> Iterator[None]:
    """Return a context in which small amounts of work are done without kernels that have never been compiled.

    The first run of a command then takes about as long as a later one. The results are the same to within rounding
    errors. `kernel_spared` decides for each kernel.
    """
    global _SPARED
    before, _SPARED = _SPARED, {}
    try:
        yield
    finally:
        _SPARED = before


def kernel_spared(module: str, name: str, seconds: float, *, slow: float = 1.0) -> bool:
    """Return whether to do work without a kernel, because there is too little work to justify compiling it.

    The answer is always False outside `sparing_kernels`, and for a kernel that has been compiled before. It becomes
    False when the ``seconds`` of a kernel, summed over the calls, amount to more than the limit. It does not depend on
    measured times. The module of the kernel is not loaded; numba is loaded only to find its cache folder.

    Parameters
    ----------
    module, name
        Module and name of the kernel.
    seconds
        Estimate of the additional CPU time (s) without the kernel.
    slow
        Limit of the lost time, as a multiple of `SPARED_S`; above 1 for a kernel that takes longer to compile.
    """
    if _SPARED is None:
        return False
    with _LOCK:
        if (module, name) not in _KEPT:
            _KEPT[module, name] = _is_kept(module, name)
        lost = _SPARED.get((module, name), 0.0) + seconds
        if _KEPT[module, name] or lost > slow * SPARED_S:
            return False
        _SPARED[module, name] = lost
        return True


def _is_kept(module: str, name: str) -> bool:
    """Return whether numba's cache on disk has code of a kernel."""
    spec = find_spec(module)
    if spec is None or spec.origin is None or not os.path.isfile(spec.origin):
        return True  # without a source, as in a bundled application, there is nothing to look for
    source = Path(spec.origin)
    index = glob.escape(f"{source.stem}.{name}-") + f"*.py{sys.version_info.major}{sys.version_info.minor}*.nbi"
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if not folder and os.access(source.parent, os.W_OK):
        return any((source.parent / "__pycache__").glob(index))
    folder = folder or os.path.dirname(kernel_folder() or "")
    return any(Path(folder).glob(f"*/{index}"))


def kernels_spared() -> bool:
    """Return whether work in this `sparing_kernels` context was done without a kernel; its duration is not typical."""
    return bool(_SPARED)


def _made(numba: Any, function: Callable[..., Any], options: dict[str, object]) -> Any:
    """Return the numba function, which has no cache on disk if no folder is writable.

    numba tries ``NUMBA_CACHE_DIR``, then the module's folder, then the user's cache folder. It fails if none is
    writable.
    """
    try:
        return numba.njit(**options)(function)
    except RuntimeError:
        return numba.njit(**{**options, "cache": False})(function)


def kernel_folder() -> str | None:
    """Return the folder in which compiled kernels of this package are cached; None if no folder is writable."""
    folder: str | None = _probe.compiled().stats.cache_path
    return folder


def _drop_unreadable_cache(dispatcher: Any) -> None:
    """Empty a kernel's cache on disk if its index cannot be loaded.

    The index of an earlier version may name a record that has been renamed since. Numba unpickles the index before it
    checks whether the source has changed, and would fail at every call.
    """
    file = _cache_file(dispatcher)
    if file is None:
        return
    try:
        file._load_index()
    except Exception:  # unpickling an old index can raise any error
        with suppress(OSError):
            file.flush()


def _save_code_before_index(dispatcher: Any) -> None:
    """Keep a kernel's index on disk consistent when several processes save at the same time.

    numba writes the index first and then the code, under the next free number. Until the code is written, a process
    that loads the index runs old code stored under that number. If two processes save code for different arguments
    together, one may load the other's code. Here the file name is derived from the source and the arguments, and the
    code is written first. At worst, an entry is lost and compiled again.
    """
    file = _cache_file(dispatcher)
    if file is None:
        return

    def save(key: Any, data: Any) -> None:
        # the same name only for the same code, independent of the state of random numbers
        digest = hashlib.sha256(repr((file._source_stamp, key)).encode()).digest()
        name = file._data_name(int.from_bytes(digest[:8], "big"))
        file._save_data(name, data)
        entries = file._load_index()
        if not entries:  # an index of an earlier version, or none: nothing refers to the existing files
            _clear(Path(file._data_path(name)))
        file._save_index({**entries, key: name})

    file.save = save


def _cache_file(dispatcher: Any) -> Any:
    """Return numba's cache of a kernel on disk; None if there is none."""
    return getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)


def _drop_unreadable_code(dispatcher: Any) -> None:
    """Compile a kernel again if its code on disk cannot be loaded, or belongs to other arguments."""
    cache: Any = getattr(dispatcher, "_cache", None)
    if not hasattr(cache, "load_overload"):
        return
    load = cache.load_overload

    def load_if_right(signature: Any, target: Any) -> Any:
        try:
            found = load(signature, target)
        except Exception:  # unpickling damaged code can raise any error
            return None
        arguments = getattr(signature, "args", signature)
        return found if found is not None and tuple(found.signature.args) == tuple(arguments) else None

    cache.load_overload = load_if_right


def _clear(kept: Path) -> None:
    """Remove a kernel's code from the disk except one file; another process saves its code again if needed."""
    base = kept.name.split(".nbc")[0].rpartition(".")[0]
    for path in kept.parent.glob(f"{glob.escape(base)}.*.nbc"):
        if path != kept:
            with suppress(OSError):
                path.unlink()


def _run_without_cache(dispatcher: Any) -> None:
    """Run a kernel even if its compiled code cannot be stored, as on a full disk; it is compiled again next time."""
    cache: Any = getattr(dispatcher, "_cache", None)
    if not hasattr(cache, "save_overload"):
        return
    save = cache.save_overload

    def save_if_possible(signature: Any, data: Any) -> None:
        with suppress(OSError):
            save(signature, data)

    cache.save_overload = save_if_possible


def _clock(dispatcher: Any) -> None:
    """Measure the time that numba spends on a kernel for each new combination of argument types."""
    compile_for = dispatcher.compile

    def counted(signature: Any) -> Any:
        start, nested, loaded = time.thread_time(), _SPENT.busy, sum(dispatcher.stats.cache_hits.values())
        with _preparing():
            made = compile_for(signature)
        if not nested and sum(dispatcher.stats.cache_hits.values()) == loaded:
            _count_compiling(time.thread_time() - start)
        return made

    dispatcher.compile = counted


def _count_compiling(seconds: float) -> None:
    """Add to the compiling time of this thread; once it is long, explain at a terminal why a first run takes longer."""
    _SPENT.compiling += seconds
    if _SPENT.compiling > NOTED_AFTER and sys.stderr is not None and sys.stderr.isatty():
        note("compiling numerical kernels; they are cached, so later runs start faster")


def njit(**options: object) -> Callable[[Callable[P, R]], Kernel[P, R]]:
    """Return a decorator that makes a function a `Kernel`, which is compiled at its first call and cached on disk.

    The ``options`` are those of `numba.njit`. By default, the kernel runs without the GIL. Two options make large
    kernels compile faster. ``inline="always"`` is for a function that kernels call in one place. Otherwise, the
    function is also compiled for calls from Python, and again within each caller. ``_nrt=False`` is for kernels without
    allocations.
    """
    settings = {"cache": True, "nogil": True, "no_cfunc_wrapper": True, **options}
    return lambda function: Kernel(function, settings)


def kernel_input(values: NDArray[Any]) -> NDArray[Any]:
    """Return ``values`` as a read-only, C-contiguous array, which is a copy only if necessary.

    numba compiles a kernel again for arrays that are writable or have another memory layout. Inputs are therefore
    always passed in this form.
    """
    import numpy as np

    found = np.ascontiguousarray(values).view()
    found.flags.writeable = False
    return found


@njit()
def _probe() -> None:
    """Do nothing; for `kernel_folder`."""
