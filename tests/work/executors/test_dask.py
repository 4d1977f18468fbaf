"""Units on dask.distributed: the same files as in one process, even if a worker is killed."""

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
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_run([unit("a", "refuse")], tmp_path / "refused", Dask(None, scheduler)))
    parts = drain(iter_run([unit(f"plane {k}", "count") for k in range(6)], tmp_path / "run", Dask(None, scheduler)))
    numbers = {u.worker: part.read_text() for u, part in zip(read_run(tmp_path / "run").units, parts, strict=True)}
    assert set(numbers.values()) <= {"0", "1"} and len(set(numbers.values())) == len(numbers), "of each worker"


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
    # the last ones may all be reported at once
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


@pytest.mark.long
def test_a_cluster_of_this_machine(tmp_path: Path) -> None:
    parts = drain(iter_run([unit("a", text="a")], tmp_path / "run", Dask(1)))
    assert parts[0].read_text() == "a"


@pytest.mark.long
def test_workers_keep_the_memory_of_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """By default dask makes glibc return all of it, a fifth of a unit's time; a setting of the user is kept."""
    monkeypatch.delenv(TRIM, raising=False)  # other clusters of this process leave theirs
    for said in (None, "123456"):
        if said is not None:
            monkeypatch.setenv(TRIM, said)
        with Dask(1) as executor:
            assert set(executor._client.run(os.environ.get, TRIM).values()) == {said}


def test_a_cluster_has_slow_idle_loops_and_logs_no_warnings() -> None:
    """On the scheduler and on every worker; elsewhere in this process dask's own settings hold."""
    from dask import config

    setting, logger = "distributed.admin.tick.interval", logging.getLogger("distributed.nanny")
    before, level = config.get(setting), logger.getEffectiveLevel()
    with Dask(1) as executor:
        assert set(executor._client.run(config.get, setting).values()) == {"500ms"}
        assert executor._client.run_on_scheduler(_periods)["tick"] == 500
        assert not logger.isEnabledFor(logging.WARNING)
    assert config.get(setting) == before != "500ms" and logger.getEffectiveLevel() == level


def _periods(dask_scheduler: Any) -> dict[str, float]:
    return {name: call.callback_time for name, call in dask_scheduler.periodic_callbacks.items()}


def test_a_scheduler_that_does_not_answer_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.work.executors.dask.CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(InputError, match=r"an answer from tcp://127\.0\.0\.1:9 within 0\.3 s, got none"):
        drain(iter_run([unit("a")], tmp_path / "run", Dask(None, "tcp://127.0.0.1:9")))
    assert not (tmp_path / "run").exists(), "nothing was begun, and nothing is left that the next run would refuse"


def test_addresses_that_are_none_and_a_missing_library_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for address in ("nonsense", "tcp://:x", "tcp://host", "tcp://host:8786:1", "//host:8786"):
        with pytest.raises(InputError, match=r"an address such as tcp://host:8786, got '"):
            Dask(None, address)
    with pytest.raises(InputError, match=r"an executor with a scheduler \(dask\), got processes"):
        RunChoice("processes", address="tcp://127.0.0.1:8786")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'pip install "lfcal\[cluster\]"'):
        Dask(1)
