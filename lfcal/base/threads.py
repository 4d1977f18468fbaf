"""Worker threads for kernels that release the GIL.

numba's own parallel loops are not used: their thread layers may abort when two threads of a program
enter them at once, as a window with jobs does.
"""

from __future__ import annotations

import atexit
import itertools
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import ExitStack, contextmanager, suppress
from contextvars import copy_context
from functools import partial
from typing import Any, Generic, TypeVar

from lfcal.base.errors import InputError
from lfcal.base.system import processors

__all__ = [
    "WORKERS",
    "bounded_threads",
    "chunks",
    "for_each_block",
    "for_each_chunk",
    "in_order",
    "one_blas_thread",
    "worker_count",
]

MAX_THREADS = 1024
"""Threads that may run at once, whoever asked for them: calls within calls have threads of their own."""

HELPER = "helper"
"""What the names of threads that stay begin with."""

T = TypeVar("T")
R = TypeVar("R")

WORKERS = "LFCAL_WORKERS"
"""Environment variable: most threads of everything."""

_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
    "TIFFFILE_NUM_THREADS",
    "BLOSC_NTHREADS",
)
"""Environment variables in which the libraries look for theirs, when they are loaded."""


def worker_count(workers: int | None = None) -> int:
    """Return ``workers``, or what the environment variable `WORKERS` says, or every processor this process may use.

    Raises
    ------
    InputError
        If the variable does not hold a whole number of at least 1.
    """
    if workers is not None:
        return max(1, workers)
    text = os.environ.get(WORKERS, "")
    if not text:
        return processors()
    if not (text.isascii() and text.isdigit() and 1 <= int(text[:9]) and len(text) < 9):
        raise InputError.expected(WORKERS, "a whole number of at least 1", repr(text[:40]), "correct or unset it")
    return int(text)


@contextmanager
def bounded_threads(workers: int | None = None) -> Iterator[int]:
    """Let everything that runs inside this block use at most `worker_count` threads; yield the number.

    That is this library's own pools, child processes, and the libraries it calls: those that are loaded already are
    told, those that are loaded later read their number from the environment. A smaller number that the user has set
    for one of them stays.
    """
    count = worker_count(workers)
    before = {name: os.environ.get(name) for name in (WORKERS, *_VARIABLES)}
    with ExitStack() as undo:
        undo.callback(_set_environment, before)
        _set_environment({WORKERS: str(count)} | {name: _at_most(before[name], count) for name in _VARIABLES})
        if "numpy" in sys.modules:
            undo.enter_context(_LIBRARIES.loaded().limit(limits=count))
        if "cv2" in sys.modules:
            cv2 = sys.modules["cv2"]
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
    """Threads that stay: starting some for each call would take small problems longer than their work.

    There are as many as ever had work at once; those that wait for work cost nothing. Of the standard library's pool
    there would be ever more: it forgets a waiting thread whose work another one took.
    """

    def __init__(self) -> None:
        self.forget()
        atexit.register(lambda: wait(self.running))  # nothing is taken away from what still runs
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self.forget)

    def forget(self) -> None:
        """Begin anew, as in a forked process, which has none of the threads."""
        self.change = threading.Condition()
        self.asked: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self.running: set[Future[Any]] = set()
        self.threads = 0

    def submit(self, function: Callable[..., R], *args: Any) -> Future[R]:
        """Let a thread that has nothing to do, or a new one, call ``function``.

        Where no more threads can be had it may not be begun: whoever waits for it cancels it, and does it itself.
        """
        result: Future[R] = Future()
        with self.change:
            self.asked = deque(one for one in self.asked if not one[0].cancelled())
            self.asked.append((result, partial(function, *args)))
            if len(self.asked) <= self.threads - len(self.running):
                self.change.notify()
            elif self.threads < MAX_THREADS:
                thread = threading.Thread(target=self._help, name=f"{HELPER}_{self.threads}", daemon=True)
                with suppress(RuntimeError):  # the system or the interpreter gives none
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
            del result, call  # nothing is held while there is nothing to do

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
            del result, call  # an error, its traceback and what failed would else hold each other

    def _no_more(self, result: Future[Any]) -> None:
        """Count the thread among those that wait before anyone learns of it: who asks again then needs no other."""
        with self.change:
            self.running.discard(result)


_HELPERS = _Helpers()


def chunks(n: int, parts: int) -> list[tuple[int, int]]:
    """Split ``range(n)`` into at most ``parts`` nearly equal ``(start, stop)`` ranges."""
    parts = max(1, min(parts, n))
    # whole-number arithmetic: the ranges differ by one item at most and leave none out
    edges = [n * k // parts for k in range(parts + 1)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]


def for_each_chunk(
    function: Callable[[int, int], R], n: int, workers: int | None = None, *, parts_per_worker: int = 4
) -> list[R]:
    """Call ``function(start, stop)`` over chunks of ``range(n)`` in threads; return the results in order.

    Parameters
    ----------
    function
        Must release the GIL for most of its time to gain anything.
    n
        Number of independent items.
    workers
        Threads; None takes every processor this process may use.
    parts_per_worker
        How many chunks each worker gets on average: more balances better and costs more calls.
    """
    count = worker_count(workers)
    return _over(function, chunks(n, count * parts_per_worker if count > 1 else 1), count)


def _over(function: Callable[[int, int], R], ranges: list[tuple[int, int]], count: int) -> list[R]:
    """Return ``function(start, stop)`` of each of ``ranges``, in order, worked out by ``count`` threads."""
    # an error keeps its short traceback, and nothing is spent on threads
    if count == 1 or len(ranges) <= 1:
        return [function(a, b) for a, b in ranges]
    return _Shared(function, ranges).done(min(count, len(ranges)))


class _Shared(Generic[R]):
    """Chunks that threads take in turn, the caller among them: it never waits for a thread that has not begun."""

    def __init__(self, function: Callable[[int, int], R], ranges: list[tuple[int, int]]) -> None:
        self.function, self.ranges = function, ranges
        self.lock, self.turns = threading.Lock(), iter(range(len(ranges)))
        self.results: dict[int, R] = {}
        self.errors: dict[int, BaseException] = {}

    def done(self, count: int) -> list[R]:
        """Return the results in order, worked out by ``count`` threads; the first error in order is raised."""
        # in the caller's context, a copy for each: where nobody waits for the caller any more, what helps it ends, too
        helping = [_HELPERS.submit(copy_context().run, self.take) for _ in range(count - 1)]
        try:
            self.take()
        finally:
            wait([one for one in helping if not one.cancel()])
        if self.errors:
            try:
                raise self.errors[min(self.errors)]
            finally:
                self.errors.clear()  # an error and its traceback would else hold each other
        return [self.results[k] for k in range(len(self.ranges))]

    def take(self) -> None:
        """Work out chunks until none is left, or one of them failed."""
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
    """Call ``function(start, stop)`` in threads over blocks of ``step`` items of ``range(n)``, the last one shorter.

    Blocks are the same for any number of workers: sums and products come out the same to the last bit.
    """
    _over(function, [(k, min(k + step, n)) for k in range(0, n, step)], worker_count(workers))


def in_order(function: Callable[[T], R], items: Iterable[T], workers: int | None = None) -> Iterator[R]:
    """Yield ``function(item)`` of each item, worked out in threads, in order: sums of them do not depend on chance.

    At most one result more than there are workers is in memory.
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
    """Take the first result; whoever asks does what no thread has begun."""
    item, result = under_way.popleft()
    try:
        return one(item) if result.cancel() else result.result()
    finally:
        # an error holds this frame, and is held by its result: both would stay until garbage is collected
        del item, result


class _Libraries:
    """The libraries that have threads of their own; finding them among all that is loaded takes milliseconds."""

    def __init__(self) -> None:
        self.modules = 0
        self.found: Any = None

    def loaded(self) -> Any:
        """Return threadpoolctl's hold on them, as of now: they are loaded by modules that need them."""
        modules = len(sys.modules)
        if self.found is None or modules != self.modules:
            from threadpoolctl import ThreadpoolController

            self.found, self.modules = ThreadpoolController(), modules
        return self.found


_LIBRARIES = _Libraries()


class _BlasGate:
    """How many callers want one BLAS thread at present, and how to undo it when the last has left."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.users = 0
        self.undo = ExitStack()

    def close(self) -> None:
        """Hold the BLAS libraries that are loaded: numpy and scipy may bring one each."""
        self.undo.enter_context(_LIBRARIES.loaded().limit(limits=1, user_api="blas"))


_GATE = _BlasGate()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let matrix products inside this block run on the calling thread alone.

    Small products inside a thread pool are up to ten times slower when each starts threads of its own. The limit
    holds for the process; it is lifted when the last of several concurrent blocks ends.
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
