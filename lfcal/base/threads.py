"""Worker threads for kernels that release the GIL.

The parallel loops of numba are not used. Its thread layers may abort when two threads of a program enter them at the
same time, as in a window with jobs.
"""

from __future__ import annotations

import atexit
import itertools
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar, copy_context
from functools import partial
from typing import Any, Generic, TypeVar

from lfcal.base.compiled import preparing_seconds
from lfcal.base.errors import InputError
from lfcal.base.system import processors

__all__ = [
    "WORKERS",
    "Meter",
    "bounded_threads",
    "chunks",
    "for_each_block",
    "for_each_chunk",
    "in_order",
    "one_blas_thread",
    "worker_count",
]

MAX_THREADS = 1024
"""Largest number of threads that may run at a time; nested calls have separate threads."""

HELPER = "helper"
"""Prefix of the names of persistent threads."""

T = TypeVar("T")
R = TypeVar("R")

WORKERS = "LFCAL_WORKERS"
"""Environment variable that limits all threads."""

_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
    "TIFFFILE_NUM_THREADS",
    "BLOSC_NTHREADS",
)
"""Environment variables from which libraries read their limits when they are loaded."""


def worker_count(workers: int | None = None) -> int:
    """Return ``workers``, at least 1; if it is None, the value of `WORKERS`, or else the number of processors.

    `WORKERS` is an environment variable.

    Raises
    ------
    InputError
        If the variable is not a whole number of at least 1.
    """
    if workers is not None:
        return max(1, workers)
    text = os.environ.get(WORKERS, "")
    if not text:
        return processors()
    if not (text.isascii() and text.isdigit() and 1 <= int(text[:9]) and len(text) < 9):
        raise InputError.expected(
            WORKERS,
            "a whole number of at least 1",
            repr(text[:40]),
            "set a whole number, or unset the variable",
        )
    return int(text)


@contextmanager
def bounded_threads(workers: int | None = None) -> Iterator[int]:
    """Return a context in which at most ``worker_count(workers)`` threads are used; yields this number.

    The limit applies to lfcal's pools, to child processes, and to numerical libraries. It is set in loaded libraries by
    a call, and for libraries loaded later by environment variables. A smaller limit that the user has set in such a
    variable is kept.
    """
    count = worker_count(workers)
    before = {name: os.environ.get(name) for name in (WORKERS, *_VARIABLES)}
    with ExitStack() as undo:
        undo.callback(_set_environment, before)
        _set_environment({WORKERS: str(count)} | {name: _at_most(before[name], count) for name in _VARIABLES})
        if "numpy" in sys.modules:
            undo.enter_context(_LIBRARIES.loaded().limit(limits=count))
        cv2: Any = sys.modules.get("cv2")
        if hasattr(cv2, "setNumThreads"):  # a damaged installation lacks it
            undo.callback(cv2.setNumThreads, cv2.getNumThreads())
            cv2.setNumThreads(min(count, cv2.getNumThreads()))
        yield count


def _at_most(set_to: str | None, count: int) -> str:
    return set_to if set_to is not None and set_to.isdigit() and 0 < int(set_to) < count else str(count)


def _set_environment(values: dict[str, str | None] | dict[str, str]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


class _Helpers:
    """Persistent threads: starting new ones for each call would take longer than small problems themselves.

    The number of threads is the largest number that was needed at the same time; waiting threads cost nothing. The pool
    of the standard library would grow without limit. It no longer counts a waiting thread as idle if another thread
    takes the work meant for it.
    """

    def __init__(self) -> None:
        self.forget()
        atexit.register(lambda: wait(self.running))  # running threads keep their objects
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self.forget)

    def forget(self) -> None:
        """Forget all threads, for example in a forked process, which does not inherit them."""
        self.change = threading.Condition()
        self.asked: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self.running: set[Future[Any]] = set()
        self.threads = 0

    def submit(self, function: Callable[..., R], *args: Any) -> Future[R]:
        """Let an idle thread, or a new one, call ``function``.

        If no more threads can be started, the call may not begin; the waiting caller then cancels it and does the work
        itself.
        """
        result: Future[R] = Future()
        with self.change:
            self.asked = deque(one for one in self.asked if not one[0].cancelled())
            self.asked.append((result, partial(function, *args)))
            if len(self.asked) <= self.threads - len(self.running):
                self.change.notify()
            elif self.threads < MAX_THREADS:
                thread = threading.Thread(target=self._help, name=f"{HELPER}_{self.threads}", daemon=True)
                with suppress(RuntimeError):  # no further thread can be started
                    thread.start()
                    self.threads += 1
        return result

    def _help(self) -> None:
        while True:
            with self.change:
                self.change.wait_for(lambda: self.asked)
                result, call = self.asked.popleft()
                if result.set_running_or_notify_cancel():
                    self.running.add(result)
            if result.running():
                self._work(result, call)
            del result, call  # an idle thread must not keep objects alive

    def _work(self, result: Future[Any], call: Callable[[], Any]) -> None:
        try:
            value = call()
        except BaseException as error:
            self._no_more(result)
            result.set_exception(error)
        else:
            self._no_more(result)
            result.set_result(value)
        finally:
            del result, call  # breaks the reference cycle of error, traceback and call

    def _no_more(self, result: Future[Any]) -> None:
        """Count the thread as idle before its result is visible, so that the next request finds it."""
        with self.change:
            self.running.discard(result)


_HELPERS = _Helpers()


class Meter:
    """Processor time of work in this thread, and in the threads of `for_each_chunk` and `for_each_block` that help it.

    The time of other work in the same process is not counted, nor that of loading and compiling kernels, which happens
    once per process.

    Attributes
    ----------
    seconds
        CPU-seconds so far.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._lock = threading.Lock()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Return a context in which the time of this thread and its helpers is counted.

        A generator must not yield inside it.
        """
        token = _METER.set(self)
        try:
            with self.timed():
                yield
        finally:
            _METER.reset(token)

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Return a context in which only the time of this thread is counted."""
        start = time.thread_time() - preparing_seconds()
        try:
            yield
        finally:
            took = time.thread_time() - preparing_seconds() - start
            with self._lock:
                self.seconds += max(0.0, took)


_METER: ContextVar[Meter | None] = ContextVar("_METER", default=None)
"""The meter of the work that this thread does or helps with."""


def chunks(n: int, parts: int) -> list[tuple[int, int]]:
    """Split ``range(n)`` into at most ``parts`` nearly equal ``(start, stop)`` ranges."""
    parts = max(1, min(parts, n))
    # integer arithmetic: the ranges differ by one item at most and leave none out
    edges = [n * k // parts for k in range(parts + 1)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]


def for_each_chunk(
    function: Callable[[int, int], R], n: int, workers: int | None = None, *, parts_per_worker: int = 4
) -> list[R]:
    """Call ``function(start, stop)`` on chunks of ``range(n)`` in threads; return the results in order.

    Parameters
    ----------
    function
        Function to call; threads save time only if it releases the GIL most of the time.
    n
        Number of independent items.
    workers
        Number of threads, as in `worker_count`.
    parts_per_worker
        Average number of chunks per worker; more chunks balance better but need more calls.
    """
    count = worker_count(workers)
    return _over(function, chunks(n, count * parts_per_worker if count > 1 else 1), count)


def _over(function: Callable[[int, int], R], ranges: list[tuple[int, int]], count: int) -> list[R]:
    """Return ``function(start, stop)`` for each of ``ranges``, in order, computed by ``count`` threads."""
    # without threads: errors keep a short traceback, and there is no overhead
    if count == 1 or len(ranges) <= 1:
        return [function(a, b) for a, b in ranges]
    return _Shared(function, ranges).done(min(count, len(ranges)))


class _Shared(Generic[R]):
    """Chunks shared by threads and the caller; the caller never waits for a thread that has not begun."""

    def __init__(self, function: Callable[[int, int], R], ranges: list[tuple[int, int]]) -> None:
        self.function, self.ranges = function, ranges
        self.lock, self.turns = threading.Lock(), iter(range(len(ranges)))
        self.results: dict[int, R] = {}
        self.errors: dict[int, BaseException] = {}

    def done(self, count: int) -> list[R]:
        """Return the results in order, computed by ``count`` threads; raise the first error in order."""
        # a copy of the caller's context for each: if the caller is abandoned, its helpers end as well
        helping = [_HELPERS.submit(copy_context().run, self.help) for _ in range(count - 1)]
        try:
            self.take()
        finally:
            wait([one for one in helping if not one.cancel()])
        if self.errors:
            try:
                raise self.errors[min(self.errors)]
            finally:
                self.errors.clear()  # breaks the reference cycle of error and traceback
        return [self.results[k] for k in range(len(self.ranges))]

    def help(self) -> None:
        """Process chunks in another thread than the caller's; the caller's meter counts the time."""
        meter = _METER.get()
        with nullcontext() if meter is None else meter.timed():
            self.take()

    def take(self) -> None:
        """Process chunks until none is left, or one has failed."""
        while not self.errors:
            with self.lock:
                k = next(self.turns, None)
            if k is None:
                return
            try:
                self.results[k] = self.function(*self.ranges[k])
            except BaseException as error:
                self.errors[k] = error


def for_each_block(function: Callable[[int, int], object], n: int, step: int, workers: int | None = None) -> None:
    """Call ``function(start, stop)`` in threads on blocks of ``step`` items of ``range(n)``; the last may be shorter.

    The blocks do not depend on the number of workers, so the result of each block is identical to the last bit.
    """
    _over(function, [(k, min(k + step, n)) for k in range(0, n, step)], worker_count(workers))


def in_order(function: Callable[[T], R], items: Iterable[T], workers: int | None = None) -> Iterator[R]:
    """Yield ``function(item)`` for each item, computed in threads; the order is that of ``items``.

    Sums of the results therefore do not depend on timing. With n = ``worker_count(workers)`` threads, at most n + 1
    results are in memory.
    """
    count = worker_count(workers)
    waiting = iter(items)
    if count == 1:
        yield from map(function, waiting)
        return
    room = threading.Semaphore(count)

    def one(item: T) -> R:
        with room:
            return function(item)

    under_way: deque[tuple[T, Future[R]]] = deque()
    try:
        under_way.extend((item, _HELPERS.submit(one, item)) for item in itertools.islice(waiting, count + 1))
        while under_way:
            yield _first(under_way, one)
            under_way.extend((item, _HELPERS.submit(one, item)) for item in itertools.islice(waiting, 1))
    finally:
        wait([result for _, result in under_way if not result.cancel()])


def _first(under_way: deque[tuple[T, Future[R]]], one: Callable[[T], R]) -> R:
    """Return the first result; the caller computes it if no thread has begun to do so."""
    item, result = under_way.popleft()
    try:
        return one(item) if result.cancel() else result.result()
    finally:
        # breaks a reference cycle of this frame, the error and its result
        del item, result


class _Libraries:
    """Libraries with separate thread pools; searching all loaded libraries takes milliseconds."""

    def __init__(self) -> None:
        self.modules = 0
        self.found: Any = None

    def loaded(self) -> Any:
        """Return threadpoolctl's controller for the libraries loaded now; modules load them on demand."""
        modules = len(sys.modules)
        if self.found is None or modules != self.modules:
            from threadpoolctl import ThreadpoolController

            self.found, self.modules = ThreadpoolController(), modules
        return self.found


_LIBRARIES = _Libraries()


class _BlasGate:
    """Number of callers that need single-threaded BLAS now, and how to restore the limit after the last one."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.users = 0
        self.undo = ExitStack()

    def close(self) -> None:
        """Limit the loaded BLAS libraries to one thread; numpy and scipy may each include one."""
        self.undo.enter_context(_LIBRARIES.loaded().limit(limits=1, user_api="blas"))


_GATE = _BlasGate()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Return a context in which matrix products run on the calling thread only.

    Small products in a thread pool are up to ten times slower if each starts further threads. The limit applies to the
    whole process until the last of several concurrent contexts ends.
    """
    with _GATE.lock:
        if _GATE.users == 0:
            _GATE.close()
        _GATE.users += 1
    try:
        yield
    finally:
        with _GATE.lock:
            _GATE.users -= 1
            if _GATE.users == 0:
                _GATE.undo.close()
