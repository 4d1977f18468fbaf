"""H in units of a plane: the file of one process to the last bit, whoever computes it; kills are in tests/work."""

from __future__ import annotations

import dataclasses
import json
import pickle
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.psf.layout import Stored
from lfcal.psf.make import units_of
from lfcal.simulate import simulate_psf
from lfcal.simulate.effects import CATALOGUE
from lfcal.simulate.effects.described import effect_from
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.plane_task import describe
from lfcal.simulate.simulate import Simulation, iter_simulate_psf
from lfcal.work import RunChoice, parts_folder
from tests.psf.test_joining import contents
from tests.simulate.common import small_camera


@pytest.fixture(scope="module")
def plan() -> ScanPlan:
    whole = ScanPlan.for_camera(small_camera(), virtual_depths=[2.5, 3.0, 4.0], cutout=31)
    return replace(whole, period=(4, 3))


@pytest.fixture(scope="module")
def direct(plan: ScanPlan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """H file of one process."""
    path = tmp_path_factory.mktemp("direct") / "H.h5"
    simulate_psf(plan, tolerance=0.1, out=path, workers=2).close()
    return contents(path)


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_bit_for_bit(plan: ScanPlan, direct: dict[str, Any], tmp_path: Path, executor: str) -> None:
    out = tmp_path / "H.h5"
    run = RunChoice(executor, workers=2)
    drain(iter_simulate_psf(plan, run=run, tolerance=0.1, out=out)).close()
    assert contents(out) == direct
    assert not parts_folder(out).exists()


def test_what_an_earlier_run_left(plan: ScanPlan, direct: dict[str, Any], tmp_path: Path) -> None:
    out = tmp_path / "H.h5"

    def work(begun: str, tolerance: float = 0.1) -> Any:
        run = RunChoice("threads", 1, begun=begun)
        return iter_simulate_psf(plan, run=run, tolerance=tolerance, out=out)

    first = work("refuse")
    for record in first:
        if record.note.startswith("1 of"):
            break
    first.close()
    folder = parts_folder(out)
    kept = next(folder.glob("*.h5"))
    stamp = kept.stat().st_mtime_ns
    with pytest.raises(InputError, match="left 1 of 3 units finished; continue from them"):
        drain(work("refuse"))
    again = work("resume")
    next(again)
    assert kept.stat().st_mtime_ns == stamp
    again.close()
    drain(work("resume")).close()
    assert contents(out) == direct
    # planes of another tolerance are none of this run
    second = work("refuse", 0.2)
    for record in second:
        if record.note.startswith("1 of"):
            break
    second.close()
    drain(work("resume")).close()
    assert contents(out) == direct


@pytest.mark.parametrize("name", CATALOGUE.names())
def test_effects_travel_as_text(name: str, plan: ScanPlan) -> None:
    effect = CATALOGUE.get(name)()
    told = json.loads(json.dumps(describe([effect])[0]))
    assert effect_from(told.pop("name"), told) == effect


def test_a_unit_is_small_and_tells_settings_apart(plan: ScanPlan) -> None:
    def unit(z: int = 0, tolerance: float = 0.1, level: str = "auto", sampling: Sampling | None = None) -> Any:
        work = Simulation(plan, "auto", level, tolerance, sampling)
        return units_of(work, Stored())[z]

    first = unit()
    assert len(pickle.dumps(first)) < 10_000
    others = [unit(1), unit(tolerance=0.11), unit(level="grid"), unit(sampling=Sampling(nodes_per_px=6))]
    assert len({first.fingerprint(), *(other.fingerprint() for other in others)}) == 5
    assert unit().fingerprint() == first.fingerprint()


def test_an_effect_of_nobody_cannot_travel(plan: ScanPlan, tmp_path: Path) -> None:
    kind: Any = CATALOGUE.get("defocus") if "defocus" in CATALOGUE else CATALOGUE.get(CATALOGUE.names()[0])

    @dataclass(frozen=True)
    class Own(kind):  # type: ignore[misc]
        pass

    run = RunChoice("threads", 1)
    with pytest.raises(InputError, match="a known effect"):
        drain(iter_simulate_psf(plan, [Own()], run=run, out=tmp_path / "H.h5"))
    assert dataclasses.is_dataclass(Own)
    assert not list(tmp_path.iterdir())
