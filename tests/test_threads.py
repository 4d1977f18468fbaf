"""How many threads: by argument, environment variable and processors; told to every library that has its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from lfcal import threads
from lfcal.errors import InputError
from lfcal.progress import Unwanted, leave_if_unwanted, wanted_while
from lfcal.threads import WORKERS, bounded_threads, chunks, for_each_block, for_each_chunk, in_order, worker_count


def test_argument_before_variable_before_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "processors", lambda: 7)
    monkeypatch.delenv(WORKERS, raising=False)
    assert worker_count() == 7 and worker_count(2) == 2 and worker_count(0) == 1
    monkeypatch.setenv(WORKERS, "3")
    assert worker_count() == 3 and worker_count(9) == 9
    monkeypatch.setenv(WORKERS, "")
    assert worker_count() == 7


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5", "²", " 1", "9" * 5000])
def test_a_wrong_variable_is_one_line(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
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
def test_threads_that_help_end_where_nobody_waits_for_the_caller(workers: int) -> None:
    went = []

    def some(start: int, stop: int) -> None:
        for k in range(start, stop):
            leave_if_unwanted()
            went.append(k)

    with wanted_while(lambda: len(went) < 5), pytest.raises(Unwanted):
        for_each_chunk(some, 1000, workers)
    assert 5 <= len(went) < 5 + workers
    for_each_chunk(some, 10, workers)
    assert set(range(10)) <= set(went)


def blas_threads() -> set[int]:
    return {int(found["num_threads"]) for found in threadpool_info()}


def test_libraries_are_told_and_told_back(monkeypatch: pytest.MonkeyPatch) -> None:
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
from lfcal.threads import bounded_threads
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


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_blocks_are_the_same_for_any_number_of_workers(workers: int) -> None:
    seen: list[tuple[int, int]] = []
    for_each_block(lambda a, b: seen.append((a, b)), 10, 4, workers)
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
