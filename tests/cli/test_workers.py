"""``--workers`` and LFCAL_WORKERS bound every thread of every command that computes."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import pytest
import typer.main
from threadpoolctl import threadpool_info

from lfcal.base.threads import WORKERS
from lfcal.cli._app import build_app
from tests.cli.conftest import Run
from tests.cli.test_every_option import walk
from tests.cli.writing import WRITERS, make_inputs

Lfcal = Callable[..., Run]

COMPUTING = (
    ("camera", "check"),
    ("camera", "sensor"),
    ("white",),
    ("views",),
    ("simulate",),
    ("accuracy",),
    ("acquire",),
    ("assemble",),
    ("inspect",),
    ("compare",),
    ("fit",),
    ("transpose",),
    ("reduce",),
    ("export",),
    ("reconstruct",),
    ("demo",),
    *(("multiplex", name) for name in ("compare", "demosaic", "views", "search", "filters", "figures")),
    *(("multiplex", name) for name in ("merits", "map", "design", "recover", "coding")),
)
IDLE = {
    ("plan",),
    ("status",),
    ("solvers",),
    ("trend",),
    ("doctor",),
    ("install-desktop",),
    ("verify",),
    ("multiplex",),
    ("multiplex", "show"),
    ("bench",),
    (),
}
IDLE |= {("camera",), *(("camera", name) for name in ("new", "import", "show"))}
"""They compute nothing that takes time, or are groups; of the benchmarks, those that compare threads take them."""


def test_every_command_that_computes_takes_workers() -> None:
    found = {
        path: "workers" in {p.name for p in command.params}
        for path, command in walk(typer.main.get_command(build_app()))
        if path[:1] != ("bench",)
    }
    assert {path for path, has in found.items() if has} >= set(COMPUTING)
    assert {path for path, has in found.items() if not has} <= IDLE


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Note the size of every pool, and the threads of BLAS and OpenCV while it is made."""
    sizes: list[int] = []
    real = ThreadPoolExecutor.__init__

    def init(self: ThreadPoolExecutor, max_workers: int | None = None, *more: Any, **options: Any) -> None:
        sizes.append(max_workers or 99)
        sizes.extend(int(found["num_threads"]) for found in threadpool_info())
        sizes.append(cv2.getNumThreads())
        real(self, max_workers, *more, **options)

    monkeypatch.setattr(ThreadPoolExecutor, "__init__", init)
    return sizes


@pytest.mark.few(5)
@pytest.mark.parametrize("how", ["--workers", WORKERS])
@pytest.mark.parametrize("name", ["transpose", "reduce", "export mat", "reconstruct npy", "white", "camera sensor"])
def test_pools_and_libraries_keep_to_it(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seen: list[int], how: str, name: str
) -> None:
    make_inputs(tmp_path)
    monkeypatch.chdir(tmp_path)
    seen.clear()
    before = threading.active_count(), cv2.getNumThreads(), os.environ.get(WORKERS)
    if how == "--workers":
        run = lfcal(*WRITERS[name].words("--workers", "1"))
    else:
        with monkeypatch.context() as patch:
            patch.setenv(WORKERS, "1")
            run = lfcal(*WRITERS[name].words())
    assert run.code == 0, run.err
    assert set(seen) <= {1}
    assert (threading.active_count(), cv2.getNumThreads(), os.environ.get(WORKERS)) == before


def test_a_wrong_variable_is_one_line(lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WORKERS, "all")
    run = lfcal("plan", "bench", "--virtual-depths", "3")
    assert run.code == 2
    words = "LFCAL_WORKERS: expected a whole number of at least 1, got 'all'; set a whole number, or unset the variable"
    assert run.err == f"lfcal: {words}\n"


def test_the_doctor_says_what_was_found(lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WORKERS, "3")
    found = lfcal("doctor", "--json").json["machine"]  # type: ignore[index, call-overload]
    assert found["threads used"] == "3 (LFCAL_WORKERS)"
    monkeypatch.delenv(WORKERS)
    found = lfcal("doctor", "--json").json["machine"]  # type: ignore[index, call-overload]
    assert found["threads used"] == f"{found['processors']} (every processor this process may use)"
