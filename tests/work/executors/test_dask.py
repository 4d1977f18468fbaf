"""Units on dask.distributed: the same files, whatever happens to a worker."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import Clock, Work, drain
from lfcal.work import RunChoice, iter_run, read_run
from lfcal.work.executors.dask import Dask
from lfcal.work.executors.threads import Threads
from lfcal.work.runs import Following
from tests.work.tasks import unit

distributed: Any = pytest.importorskip("distributed", reason="dask.distributed is not installed")

TRIM = "MALLOC_TRIM_THRESHOLD_"


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler that runs already, with two workers."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit=0) as cluster:
        yield cluster.scheduler_address


def test_the_same_files_as_in_one_process(scheduler: str, tmp_path: Path) -> None:
    units = [unit(f"plane {k}", text=f"{k}") for k in range(5)]
    here = drain(iter_run(units, tmp_path / "here", Threads(1)))
    there = drain(iter_run(units, tmp_path / "there", Dask(None, scheduler)))
    assert [part.name for part in here] == [part.name for part in there]
    assert [part.read_text() for part in there] == list("01234")
    state = read_run(tmp_path / "there")
    assert (state.executor, state.workers, state.count("done")) == ("dask", 2, 5)
    assert all(u.worker.startswith("tcp://") and u.seconds >= 0 for u in state.units)


def test_units_are_done_in_order_and_joined_meanwhile(scheduler: str, tmp_path: Path) -> None:
    """The last given came first, so that no part could be joined before all were there."""
    units = [unit(f"plane {k:02d}", text=f"{k}") for k in range(30)]
    taken: list[int] = []

    def join(parts: tuple[Path, ...]) -> Work[None]:
        clock = Clock("joining", len(parts))
        yield clock.at(0)
        for k, part in enumerate(parts):
            assert part.read_text() == f"{k}"
            taken.append(k)
            yield clock.at(k + 1)

    following = Following(join)
    drain(iter_run(units, tmp_path / "run", Dask(None, scheduler), following=following))
    # the last ones may all be told of at once
    assert taken == list(range(len(taken))) and len(taken) > 15
    following.close()


@pytest.mark.long
def test_a_worker_that_is_killed(scheduler: str, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    units = [unit(f"plane {k}", text=f"{k}", seen=str(seen)) for k in range(3)]
    units[1] = unit("plane 1", "die", text="1", times=2, marks=str(tmp_path / "marks"), seen=str(seen))
    parts = drain(iter_run(units, tmp_path / "run", Dask(None, scheduler)))
    assert [part.read_text() for part in parts] == list("012")
    # one thread each: there is a worker for every processor
    assert {tuple(line.split()[1:]) for line in seen.read_text().splitlines()} == {("1", "1")}


def test_what_a_unit_refuses_is_told(scheduler: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_run([unit("a", "refuse")], tmp_path / "run", Dask(None, scheduler)))


@pytest.mark.long
def test_a_cluster_of_this_machine(tmp_path: Path) -> None:
    parts = drain(iter_run([unit("a", text="a")], tmp_path / "run", Dask(1)))
    assert parts[0].read_text() == "a"


@pytest.mark.long
def test_workers_keep_the_memory_of_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """By default dask tells glibc to hand all of it back, a fifth of a unit's time; what the user says of it holds."""
    monkeypatch.delenv(TRIM, raising=False)  # other clusters of this process leave theirs
    for said in (None, "123456"):
        if said is not None:
            monkeypatch.setenv(TRIM, said)
        with Dask(1) as executor:
            assert set(executor._client.run(os.environ.get, TRIM).values()) == {said}


def test_idle_loops_are_looked_at_seldom() -> None:
    """On the scheduler and on every worker; elsewhere in this process dask's own setting holds."""
    from dask import config

    setting = "distributed.admin.tick.interval"
    before = config.get(setting)
    with Dask(1) as executor:
        assert set(executor._client.run(config.get, setting).values()) == {"500ms"}
        scheduler = executor._client.run_on_scheduler(_periods)
        assert scheduler["tick"] == 500
    assert config.get(setting) == before != "500ms"


def _periods(dask_scheduler: Any) -> dict[str, float]:
    return {name: call.callback_time for name, call in dask_scheduler.periodic_callbacks.items()}


def test_workers_have_numbers(scheduler: str, tmp_path: Path) -> None:
    units = [unit(f"plane {k}", "count") for k in range(6)]
    parts = drain(iter_run(units, tmp_path / "run", Dask(None, scheduler)))
    assert {part.read_text() for part in parts} <= {"0", "1"}
    numbers = {u.worker: part.read_text() for u, part in zip(read_run(tmp_path / "run").units, parts, strict=True)}
    assert len(set(numbers.values())) == len(numbers)


def test_nobody_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.work.executors.dask.CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(InputError, match=r"an answer from tcp://127\.0\.0\.1:9 within 0\.3 s, got none"):
        drain(iter_run([unit("a")], tmp_path / "run", Dask(None, "tcp://127.0.0.1:9")))
    assert not (tmp_path / "run").exists(), "nothing was begun, and nothing is left that the next run would refuse"


@pytest.mark.parametrize("address", ["nonsense", "tcp://:x", "tcp://host", "tcp://host:8786:1", "//host:8786"])
def test_what_is_no_address(address: str) -> None:
    with pytest.raises(InputError, match=r"an address such as tcp://host:8786, got '"):
        Dask(None, address)


def test_dask_says_nothing_beside_the_journal() -> None:
    logger = logging.getLogger("distributed.nanny")
    before = logger.getEffectiveLevel()
    with Dask(1):
        assert not logger.isEnabledFor(logging.WARNING)
    assert logger.getEffectiveLevel() == before


def test_without_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'pip install "lfcal\[cluster\]"'):
        Dask(1)


def test_an_address_is_for_dask_alone() -> None:
    with pytest.raises(InputError, match=r"an executor with a scheduler \(dask\), got processes"):
        RunChoice("processes", address="tcp://127.0.0.1:8786")
