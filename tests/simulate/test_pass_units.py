"""Passes in units: the same H as without, and after a stop the rest of it alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import InputError, StorageError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.psf import open_psf
from lfcal.simulate.plane_task import PlaneTask
from lfcal.simulate.progressive import iter_refine_psf
from lfcal.work import RunChoice, parts_folder, read_run
from tests.psf.test_joining import contents
from tests.simulate.common import small_camera

GO_ON = RunChoice("threads", 1, begun="resume")


@pytest.fixture
def plan() -> ScanPlan:
    whole = ScanPlan.for_camera(small_camera(), virtual_depths=[2.5, 4.0], cutout=31)
    return replace(whole, period=(2, 3))


class Computed:
    """Planes that were computed, by tolerance; from the n-th on they fail where it is asked for."""

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


def refine(plan: ScanPlan, out: Path, run: RunChoice | None = GO_ON, tolerance: float = 0.05) -> None:
    drain(iter_refine_psf(plan, tolerance=tolerance, out=out, workers=1, run=run)).close()


@pytest.mark.long
def test_planes_are_joined_from_none_to_all(plan: ScanPlan, tmp_path: Path) -> None:
    work = iter_refine_psf(plan, tolerance=0.05, out=tmp_path / "H.h5", workers=1, run=GO_ON)
    joined: list[int] = []
    seen = 0
    while True:
        try:
            said = next(work)
        except StopIteration as end:
            end.value.close()
            break
        joined = [*joined, said.done] if said.stage.endswith("join planes") else []
        assert joined == list(range(len(joined)))
        seen = max(seen, len(joined))
    assert seen == 3


def test_the_same_file_in_units_and_without(plan: ScanPlan, tmp_path: Path) -> None:
    refine(plan, tmp_path / "one.h5", None)
    refine(plan, tmp_path / "two.h5", RunChoice("threads", 1))
    assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5")
    assert {path.name for path in tmp_path.iterdir()} == {"one.h5", "two.h5"}


@pytest.mark.few(1)
@pytest.mark.parametrize("fails_from", range(6))
def test_it_goes_on_wherever_it_was_stopped(
    plan: ScanPlan, tmp_path: Path, computed: Computed, fails_from: int
) -> None:
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
def test_a_file_that_is_another_or_a_pass_of_others_is_made_anew(
    plan: ScanPlan, tmp_path: Path, computed: Computed
) -> None:
    out = tmp_path / "H.h5"
    computed.fails_from = 3
    with pytest.raises(StorageError):
        refine(plan, out)
    with open_psf(out) as H:
        assert float(H.facts.known()["error"].max()) > 0.05
    computed.fails_from, computed.planes = None, []
    out.touch()  # somebody wrote it
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
