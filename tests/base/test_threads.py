"""How many threads: by argument, environment variable and processors; also for every library that has its own."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from lfcal.base import threads
from lfcal.base.errors import InputError
from lfcal.base.progress import WorkAbandoned, abandonable, raise_if_abandoned
from lfcal.base.system import processors
from lfcal.base.threads import WORKERS, bounded_threads, chunks, for_each_block, for_each_chunk, in_order, worker_count


def test_argument_before_variable_before_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "processors", lambda: 7)
    monkeypatch.delenv(WORKERS, raising=False)
    assert worker_count() == 7 and worker_count(2) == 2 and worker_count(0) == 1
    monkeypatch.setenv(WORKERS, "3")
    assert worker_count() == 3 and worker_count(9) == 9
    monkeypatch.setenv(WORKERS, "")
    assert worker_count() == 7


def test_a_wrong_variable_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("0", "-1", "two", "1.5", "²", " 1", "9" * 5000):
        monkeypatch.setenv(WORKERS, text)
        with pytest.raises(InputError, match=r"LFCAL_WORKERS: expected a whole number of at least 1, got ") as caught:
            worker_count()
        assert len(str(caught.value)) < 200


def test_chunks_keep_to_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every part waits until as many run as may: one more would be seen."""
    running, most, lock = 0, 0, threading.Lock()

    def work(_: int, __: int) -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0)
        with lock:
            running -= 1

    with bounded_threads(2):
        for_each_chunk(work, 64)
    assert 1 <= most <= 2
    assert chunks(5, 3) == [(0, 1), (1, 3), (3, 5)]


@pytest.mark.parametrize("workers", [1, 3])
def test_a_meter_counts_its_own_work_in_any_number_of_threads(workers: int) -> None:
    """Compared with the sum over the parts, each measured by its thread; work of another thread is not counted."""
    parts, stop = [], threading.Event()

    def busy(start: int, stop: int) -> None:
        begun = time.thread_time()
        while time.thread_time() - begun < 0.004 * (stop - start):
            sum(range(1000))
        parts.append(time.thread_time() - begun)

    other = threading.Thread(target=lambda: [None for _ in iter(stop.is_set, True)])
    other.start()
    try:
        meter = threads.Meter()
        for _ in range(2):
            with meter.running():
                for_each_chunk(busy, 12, workers)
    finally:
        stop.set()
        other.join()
    assert sum(parts) >= 0.096 and sum(parts) <= meter.seconds <= sum(parts) + 0.05
    for_each_chunk(busy, 12, workers)
    assert meter.seconds < sum(parts), "it has stopped"


@pytest.mark.parametrize("workers", [1, 3])
def test_threads_that_help_end_where_nobody_waits_for_the_caller(workers: int) -> None:
    went = []

    def some(start: int, stop: int) -> None:
        for k in range(start, stop):
            raise_if_abandoned()
            went.append(k)

    with abandonable(lambda: len(went) < 5), pytest.raises(WorkAbandoned):
        for_each_chunk(some, 1000, workers)
    assert 5 <= len(went) < 5 + workers
    for_each_chunk(some, 10, workers)
    assert set(range(10)) <= set(went)


def blas_threads() -> set[int]:
    return {int(found["num_threads"]) for found in threadpool_info()}


def test_libraries_take_the_number_and_get_theirs_back(monkeypatch: pytest.MonkeyPatch) -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    before = blas_threads(), cv2.getNumThreads()
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("MKL_NUM_THREADS", "64")
    with bounded_threads(3) as count:
        assert count == 3 and worker_count() == 3
        assert os.environ["OMP_NUM_THREADS"] == "1", "what the user has bounded further stays"
        assert os.environ["OPENBLAS_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "3"
        with bounded_threads(1):
            assert blas_threads() <= {1} and cv2.getNumThreads() == 1
            assert os.environ[WORKERS] == "1"
        assert worker_count() == 3
    assert (blas_threads(), cv2.getNumThreads()) == before
    assert "OPENBLAS_NUM_THREADS" not in os.environ and os.environ["MKL_NUM_THREADS"] == "64"


LATE = """
import json, sys
from lfcal.base.threads import bounded_threads
with bounded_threads():
    import cv2, numpy, scipy.linalg, tifffile
    from threadpoolctl import threadpool_info
    counts = [found["num_threads"] for found in threadpool_info()]
    print(json.dumps([counts, cv2.getNumThreads(), tifffile.TIFF.MAXWORKERS]))
"""


def test_libraries_that_are_loaded_later_find_the_number() -> None:
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
    environment = {k: v for k, v in os.environ.items() if k not in names} | {WORKERS: "1"}
    done = subprocess.run([sys.executable, "-c", LATE], env=environment, capture_output=True, text=True, check=True)
    counts, opencv, tiff = json.loads(done.stdout)
    assert set(counts) == {1} and opencv == 1 and tiff == 1


LATER = """
import json, numpy
from lfcal.base.threads import bounded_threads, one_blas_thread
with bounded_threads(1), one_blas_thread():
    pass
import scipy.linalg
from threadpoolctl import threadpool_info
counts = []
for held in (bounded_threads(1), one_blas_thread()):
    with held:
        counts.append([found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"])
print(json.dumps([counts, [found["num_threads"] for found in threadpool_info()]]))
"""


@pytest.mark.long
def test_libraries_that_are_loaded_between_are_held_too() -> None:
    environment = {k: v for k, v in os.environ.items() if k != WORKERS} | {"OPENBLAS_NUM_THREADS": "2"}
    done = subprocess.run([sys.executable, "-c", LATER], env=environment, capture_output=True, text=True, check=True)
    held, after = json.loads(done.stdout)
    assert {count for counts in held for count in counts} == {1}
    assert max(after) > 1 or processors() == 1


def test_blocks_are_the_same_for_any_number_of_workers() -> None:
    for workers in (1, 2, 5):
        seen: list[tuple[int, int]] = []
        for_each_block(lambda a, b, seen=seen: seen.append((a, b)), 10, 4, workers)
        assert sorted(seen) == [(0, 4), (4, 8), (8, 10)]


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_in_order_few_at_a_time(workers: int) -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for k in range(20):
            taken.append(k)
            yield k

    found = in_order(lambda k: k * k, items(), workers)
    for k in range(20):
        assert next(found) == k * k
        assert len(taken) <= k + 2 + workers
    assert list(found) == []


def test_an_error_among_results_in_order() -> None:
    with pytest.raises(ZeroDivisionError):
        list(in_order(lambda k: 1 / k, [1, 2, 0, 3], 2))


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[threading.Thread]:
    """Count threads from now on, none being left of before."""
    found: list[threading.Thread] = []
    start = threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda thread: (found.append(thread), start(thread)))
    monkeypatch.setattr(threads, "_HELPERS", threads._Helpers())
    return found


def test_threads_stay(begun: list[threading.Thread]) -> None:
    """A call begins no thread where one of an earlier call has nothing to do, be it asleep or just done."""
    for _ in range(200):
        meet = threading.Barrier(3)
        assert len(for_each_chunk(lambda a, b, meet=meet: meet.wait(), 3, 3)) == 3
        assert list(in_order(lambda k: k, range(9), 3)) == list(range(9))
    assert len(begun) <= 4, "as many as are asked for at once"


def test_threads_do_not_grow_while_many_ask(begun: list[threading.Thread]) -> None:
    """Two callers at once, each with two of three threads to help, whose work others may take."""
    callers = [
        threading.Thread(target=lambda: [for_each_chunk(lambda a, b: b - a, 24, 3) for _ in range(300)])
        for _ in range(2)
    ]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(begun) - len(callers) <= 4


def test_no_thread_to_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    """As at the end of the interpreter, or where a system allows no more: the caller does all of it."""

    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threads, "_HELPERS", threads._Helpers())
    monkeypatch.setattr(threading.Thread, "start", refuse)
    assert for_each_chunk(lambda a, b: b - a, 24, 3) == [2] * 12
    assert list(in_order(lambda k: k, range(9), 3)) == list(range(9))


def test_nothing_is_held_between_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was worked on, and what was cancelled, would else stay in memory until the next call."""

    class Large:
        pass

    monkeypatch.setattr(threads, "_HELPERS", threads._Helpers())
    held = []
    for _ in range(20):
        large = Large()
        held.append(weakref.ref(large))
        for_each_chunk(lambda a, b, large=large: None, 24, 3)
        list(in_order(lambda k, large=large: None, range(9), 3))
        with suppress(ZeroDivisionError):
            for_each_chunk(lambda a, b, large=large: 1 / 0, 24, 3)
        del large
    meet = threading.Barrier(5)
    for_each_chunk(lambda a, b: meet.wait(), 5, 5, parts_per_worker=1)  # each thread has let go of what was before
    gc.collect()
    assert sum(one() is not None for one in held) == 0


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave one thread to help, whoever asks."""
    monkeypatch.setattr(threads, "MAX_THREADS", 1)
    monkeypatch.setattr(threads, "_HELPERS", threads._Helpers())


@pytest.mark.usefixtures("few")
def test_calls_within_calls_never_wait_for_each_other() -> None:
    def inner(k: int) -> int:
        return sum(in_order(lambda j: j * k, range(5), 3)) + sum(for_each_chunk(lambda a, b: b - a, 8, 4))

    assert list(in_order(inner, range(6), 3)) == [10 * k + 8 for k in range(6)]
    assert for_each_chunk(lambda a, b: sum(map(inner, range(a, b))), 6, 3, parts_per_worker=2) == [
        10 * k + 8 for k in range(6)
    ]


def test_the_first_error_of_chunks_is_raised_and_no_chunk_runs_on() -> None:
    begun = threading.Barrier(2)
    ended = []

    def work(start: int, stop: int) -> None:
        if start < 2:
            begun.wait()
        if start == 0:
            raise KeyError(start)
        if start == 1:
            ended.append(start)
            raise ValueError(start)
        raise AssertionError("nothing is begun after an error")

    with pytest.raises(KeyError) as caught:
        for_each_chunk(work, 50, 2, parts_per_worker=25)
    assert ended == [1] and caught.value.__context__ is None


def test_results_that_are_not_taken_are_waited_for() -> None:
    done = []
    found = in_order(lambda k: done.append(k) or k, range(100), 2)
    assert next(found) == 0
    found.close()
    before = list(done)
    assert list(in_order(lambda k: k, range(10), 2)) == list(range(10))
    assert len(before) <= 4 and done == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_has_threads_of_its_own() -> None:
    code = (
        "import os, sys, warnings\n"
        "warnings.simplefilter('ignore')\n"
        "from lfcal.base.threads import for_each_chunk\n"
        "assert for_each_chunk(lambda a, b: b - a, 8, 4) == [1] * 8\n"
        "child = os.fork()\n"
        "found = for_each_chunk(lambda a, b: b - a, 8, 4)\n"
        "if child == 0:\n"
        "    os._exit(0 if found == [1] * 8 else 3)\n"
        "sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=100).returncode == 0


def test_an_error_releases_what_failed_at_once() -> None:
    """Without the collector of garbage, which may take its time while gigabytes are held."""

    class Large:
        pass

    def fail(_: Large) -> None:
        raise KeyError("no")

    helpers, large = threads._Helpers(), Large()
    held = weakref.ref(large)
    gc.disable()
    try:
        failed = helpers.submit(fail, large)
        assert isinstance(failed.exception(), KeyError)
        del failed, large
        helpers.submit(int).result()  # the one thread has let go of it
        assert held() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("workers", [2, 3])
def test_an_error_among_results_releases_at_once_too(workers: int) -> None:
    class Large:
        pass

    def fail(_: Large) -> None:
        raise KeyError("no")

    items = [Large() for _ in range(5)]
    held = [weakref.ref(item) for item in items]
    gc.disable()
    try:
        with suppress(KeyError):
            list(in_order(fail, items, workers))
        del items
        patience = 10_000  # of threads that have done their last and are about to let go of it
        while patience and any(one() is not None for one in held):
            time.sleep(0.001)
            patience -= 1
        assert patience, "held until garbage is collected"
    finally:
        gc.enable()


def test_what_helps_is_waited_for_at_the_end_of_the_program() -> None:
    """A thread that the end of the program does not wait for asked for it: what it writes is whole all the same."""
    code = (
        "import threading, time\n"
        "from lfcal.base.threads import for_each_chunk\n"
        "meet = threading.Barrier(3)\n"
        "def work(a, b):\n"
        "    meet.wait()\n"
        "    time.sleep(0.3)\n"
        "    if 'helper' in threading.current_thread().name:\n"
        "        print('whole', flush=True)\n"
        "ask = lambda: for_each_chunk(work, 2, 2, parts_per_worker=1)\n"
        "threading.Thread(target=ask, daemon=True).start()\n"
        "meet.wait()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, timeout=100, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "whole\n", "")
