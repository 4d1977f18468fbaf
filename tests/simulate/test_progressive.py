"""H in passes: whole after the first, better after each, kept when stopped."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix, open_psf
from lfcal.simulate import progressive
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.progressive import Pass, iter_refine_psf, passes_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.simulate import simulate_psf
from lfcal.work import RunChoice
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
def test_no_pass_is_open_when_the_next_takes_its_name(
    plan: ScanPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_units: bool
) -> None:
    """As Windows asks; and none is left open."""
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
    work = iter_refine_psf(
        plan,
        tolerance=0.03,
        out=out,
        workers=1,
        on_pass=lambda matrix: done.append(float(np.max(matrix.facts.known()["error"]))),
    )
    for record in work:
        if len(done) == 2 and record.stage.startswith("pass 3") and record.done:
            break
    work.close()
    assert [path.name for path in tmp_path.iterdir()] == ["H.h5"], "nothing half-written stays"
    with open_psf(out) as kept:
        assert float(np.max(kept.facts.known()["error"])) == done[1]
        assert kept.provenance["simulated"]["tolerance"] == pytest.approx(0.3), "the second pass of four"


def test_planes_that_keep_the_tolerance_are_not_computed_again(
    plan: ScanPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counted, not timed."""
    made: list[tuple[int, float]] = []

    class Counted(PlaneResponse):
        def __init__(self, plan: ScanPlan, z: int, *args: object, tolerance: float, **kwargs: object) -> None:
            super().__init__(plan, z, *args, tolerance=tolerance, **kwargs)  # type: ignore[arg-type]
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

    for _ in iter_refine_psf(plan, choose, tolerance=0.1, out=tmp_path / "H.h5", workers=1):  # type: ignore[arg-type]
        pass
    assert asked == [1.0, pytest.approx(1 / 3), 0.1]
