"""H in passes: whole after the first, better after each, kept when stopped; the same in units."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError, StorageError, drain
from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix, open_psf
from lfcal.simulate import PlaneResponse, iter_refine_psf, plan_effects, progressive, simulate_psf
from lfcal.simulate.plane_task import PlaneTask
from lfcal.simulate.progressive import Pass, passes_for
from lfcal.work import RunChoice, parts_folder, read_run
from tests.psf.test_joining import contents
from tests.simulate.common import difference, small_camera
from tests.windows_rules import keep_open_files


@pytest.fixture
def plan() -> ScanPlan:
    whole = ScanPlan.for_camera(small_camera(), virtual_depths=[2.5, 4.0], cutout=31)
    return replace(whole, period=(2, 3))


def test_passes_lead_to_the_tolerance() -> None:
    assert passes_for(0.03) == (Pass("geometric", 1.0), Pass("auto", 0.3), Pass("auto", 0.1), Pass("auto", 0.03))
    assert [one.tolerance for one in passes_for(0.3)] == [1.0, 0.3], "nothing between rays and a coarse tolerance"
    assert passes_for(0.1, "geometric") == (Pass("geometric", 0.1),)
    with pytest.raises(InputError, match="tolerance"):
        passes_for(0.0)


def test_every_pass_is_a_whole_h_labelled_with_its_error(plan: ScanPlan, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    seen: list[tuple[np.ndarray, list[float]]] = []

    def look(matrix: PSFMatrix) -> None:
        with open_psf(out) as found:  # what is on the disk now
            seen.append((found[:], [float(e) for e in found.facts.known()["error"]]))

    stages = []
    work = iter_refine_psf(plan, tolerance=0.05, out=out, workers=1, on_pass=look)
    with pytest.raises(StopIteration) as stop:
        while True:
            stages.append(next(work))
    stop.value.value.close()
    assert len(seen) == 3 and {r.stage for r in stages} >= {"pass 1 of 3, simulate plane 2 of 2"}
    assert "H so far within" in stages[-1].note
    truth = simulate_psf(plan, tolerance=0.015, workers=1)[:]
    worst = [max(errors) for _, errors in seen]
    assert worst == sorted(worst, reverse=True) and worst[-1] <= 0.05
    for found, errors in seen:
        for z in range(2):
            # a plane's label holds for what is in the file; estimates of what is left out within a factor of 2
            assert difference(found[z], truth[z]) <= 2 * errors[z] + 0.015


@pytest.mark.few(1)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks /proc what is open")
@pytest.mark.parametrize("in_units", [False, True])
def test_no_pass_is_open_when_the_next_takes_its_name(plan, tmp_path, monkeypatch, in_units):
    """As Windows requires; and none is left open."""
    keep_open_files(monkeypatch, tmp_path)
    passes: list[PSFMatrix] = []
    run = RunChoice() if in_units else None
    work = iter_refine_psf(plan, tolerance=0.3, out=tmp_path / "H.h5", on_pass=passes.append, run=run)
    with drain(work) as last:
        assert len(passes) == 2 and last is passes[-1] and np.isfinite(last[0, 0, 0]).all()
        with pytest.raises(ValueError, match=r"."):
            passes[0][0, 0, 0]
    (tmp_path / "H.h5").unlink()


def test_stopping_keeps_the_last_whole_pass(plan: ScanPlan, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    done: list[float] = []

    def keep(matrix: PSFMatrix) -> None:
        done.append(float(np.max(matrix.facts.known()["error"])))

    work = iter_refine_psf(plan, tolerance=0.03, out=out, workers=1, on_pass=keep)
    for record in work:
        if len(done) == 2 and record.stage.startswith("pass 3") and record.done:
            break
    work.close()
    assert [path.name for path in tmp_path.iterdir()] == ["H.h5"], "nothing half-written stays"
    with open_psf(out) as kept:
        assert float(np.max(kept.facts.known()["error"])) == done[1]
        assert kept.provenance["simulated"]["tolerance"] == pytest.approx(0.3), "the second pass of four"


def test_planes_that_keep_the_tolerance_are_not_computed_again(plan, tmp_path, monkeypatch):
    made: list[tuple[int, float]] = []

    class Counted(PlaneResponse):
        def __init__(self, plan: ScanPlan, z: int, *args: object, tolerance: float, **kwargs: object) -> None:
            super().__init__(plan, z, *args, tolerance=tolerance, **kwargs)
            made.append((z, tolerance))

    monkeypatch.setattr("lfcal.simulate.plane_task.PlaneResponse", Counted)
    monkeypatch.setattr(progressive, "passes_for", lambda *_: (Pass("wave", 0.05), Pass("wave", 0.05)))
    effects = plan_effects(plan, 0.05)
    for _ in iter_refine_psf(plan, effects, out=tmp_path / "H.h5", workers=1):
        pass
    assert [z for z, _ in made] == [0, 1]


def test_effects_are_chosen_for_each_pass(plan: ScanPlan, tmp_path: Path) -> None:
    asked = []

    def choose(tolerance: float) -> object:
        asked.append(tolerance)
        return plan_effects(plan, tolerance)

    for _ in iter_refine_psf(plan, choose, tolerance=0.1, out=tmp_path / "H.h5", workers=1):
        pass
    assert asked == [1.0, pytest.approx(1 / 3), 0.1]


RESUME = RunChoice("threads", 1, begun="resume")


class Computed:
    """Planes that were computed, by tolerance; from the n-th on they fail if requested."""

    def __init__(self) -> None:
        self.planes: list[tuple[float, int]] = []
        self.fails_from: int | None = None


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Computed]:
    found, real = Computed(), PlaneTask.compute

    def counted(self: PlaneTask, out: Any, workers: int | None) -> Any:
        if found.fails_from is not None and len(found.planes) >= found.fails_from:
            raise StorageError("H.h5: the disk is full; make room")
        found.planes.append((round(self.tolerance + self.left_out, 6), self.z))
        return (yield from real(self, out, workers))

    monkeypatch.setattr(PlaneTask, "compute", counted)
    yield found


def refine(plan: ScanPlan, out: Path, run: RunChoice | None = RESUME, tolerance: float = 0.05) -> None:
    drain(iter_refine_psf(plan, tolerance=tolerance, out=out, workers=1, run=run)).close()


def test_the_same_file_in_units_and_without(plan: ScanPlan, tmp_path: Path) -> None:
    refine(plan, tmp_path / "one.h5", None)
    refine(plan, tmp_path / "two.h5", RunChoice("threads", 1))
    assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5")
    assert {path.name for path in tmp_path.iterdir()} == {"one.h5", "two.h5"}


@pytest.mark.few(1)
@pytest.mark.parametrize("fails_from", range(6))
def test_it_continues_wherever_it_was_stopped(plan, tmp_path, computed, fails_from):
    out = tmp_path / "H.h5"
    refine(plan, tmp_path / "whole.h5", None)
    whole, computed.planes = computed.planes, []
    if fails_from >= len(whole):
        pytest.skip("it was whole before")
    computed.fails_from = fails_from
    with pytest.raises(StorageError, match="disk is full"):
        refine(plan, out)
    assert computed.planes == whole[:fails_from] and read_run(parts_folder(out)).units
    computed.fails_from = None
    refine(plan, out)
    assert computed.planes == whole, "nothing is computed twice"
    assert contents(out) == contents(tmp_path / "whole.h5") and not parts_folder(out).exists()


@pytest.mark.long
def test_passes_of_another_file_or_tolerance_are_computed_again(plan, tmp_path, computed):
    out = tmp_path / "H.h5"
    computed.fails_from = 3
    with pytest.raises(StorageError):
        refine(plan, out)
    with open_psf(out) as H:
        assert float(H.facts.known()["error"].max()) > 0.05
    computed.fails_from, computed.planes = None, []
    out.touch()  # as another program may
    refine(plan, out)
    assert computed.planes[0] == (1.0, 0), "from the first pass on"
    with pytest.raises(InputError, match="earlier run left"):
        parts_folder(out).mkdir()
        computed.fails_from, computed.planes = 1, []
        with pytest.raises(StorageError):
            refine(plan, out)
        refine(plan, out, RunChoice("threads", 1))
    computed.fails_from, computed.planes = None, []
    refine(plan, out, RunChoice("threads", 1, begun="discard"))
    assert computed.planes[0] == (1.0, 0) and not parts_folder(out).exists()
