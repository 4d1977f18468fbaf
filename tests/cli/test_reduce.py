"""``lfcal reduce``: H within a tolerance, file to file, in units and after a stop."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.saving import iter_transpose_file
from lfcal.work import parts_folder
from tests.cli.conftest import Run, small_plan
from tests.cli.test_units import interrupted
from tests.psf.test_joining import contents
from tests.psf.test_reduced_file import matrix

Lfcal = Callable[..., Run]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder, the current one, with an H of which much is known."""
    monkeypatch.chdir(tmp_path)
    save(matrix(), tmp_path / "H.h5")
    return tmp_path


@pytest.mark.parametrize("tolerance", [0.05, 0.005])
def test_within_the_tolerance_and_smaller(lfcal: Lfcal, place: Path, tolerance: float) -> None:
    run = lfcal("reduce", "H.h5", "-o", "small.h5", "--tolerance", tolerance)
    assert run.code == 0 and "small.h5: H (2, 5, 5, 15, 15), " in run.out and "no pattern loses more than" in run.out
    with open_psf(place / "H.h5") as H, open_psf(place / "small.h5") as small:
        lacking = np.abs(small[:].astype(float) - H[:]).sum(axis=(3, 4))
        assert (lacking <= tolerance * np.abs(H[:].astype(float)).sum(axis=(3, 4))).all() and lacking.any()
    assert (place / "small.h5").stat().st_size < (place / "H.h5").stat().st_size


def test_json(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("reduce", "H.h5", "--out", "small.h5", "--compression", "none", "--workers", 1, "--json")
    found = run.json
    assert isinstance(found, dict) and found["tolerance"] == 0.005
    bound = np.array(found["bound"])
    assert bound.shape == (2, 3) and 0 < bound[:, 2].max() <= 0.005
    assert found["bytes"] == (place / "small.h5").stat().st_size > 2 * 2 * 25 * 225


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_the_same_file_in_units(lfcal: Lfcal, place: Path, executor: str) -> None:
    assert lfcal("reduce", "H.h5", "-o", "one.h5").code == 0
    run = lfcal("reduce", "H.h5", "-o", "two.h5", "--executor", executor, "--workers", 2)
    assert run.code == 0, run.err
    assert contents(place / "one.h5") == contents(place / "two.h5")
    assert not parts_folder(place / "two.h5").exists()
    other = lfcal("reduce", "H.h5", "-o", "o.h5", "--executor", "threads", "--scheduler", "tcp://a:1")
    assert other.code == 2 and "an executor with a scheduler (dask)" in other.err


def test_what_an_earlier_run_left(lfcal: Lfcal, place: Path) -> None:
    words = ("reduce", "H.h5", "-o", "out.h5")
    interrupted(place / "out.h5")
    refused = lfcal(*words)
    assert refused.code == 2 and "continue from them (--resume), or start again (--force)" in refused.err
    assert lfcal(*words, "--resume").code == 0
    assert not parts_folder(place / "out.h5").exists()
    interrupted(place / "out.h5")
    assert lfcal(*words, "--force").code == 0
    assert not parts_folder(place / "out.h5").exists()


def test_a_refused_plane_keeps_those_that_are_done(lfcal: Lfcal, place: Path) -> None:
    bad = matrix()[:].copy()
    bad[0] = 0  # which any steps hold
    save(PSFMatrix(bad), place / "bad.h5")
    words = ("reduce", "bad.h5", "-o", "out.h5", "--tolerance", 1e-6, "--executor", "threads", "--workers", 1)
    run = lfcal(*words)
    assert run.code == 2
    assert "storage tolerance: expected a tolerance that at most 65535 steps" in run.err
    assert "kept: 1 of 2 units in out.h5.parts; --resume continues with them" in run.err
    assert not (place / "out.h5").exists()


@pytest.mark.parametrize("tolerance", ["0", "1", "-0.1", "nan"])
def test_a_tolerance_is_a_share(lfcal: Lfcal, place: Path, tolerance: str) -> None:
    run = lfcal("reduce", "H.h5", "-o", "out.h5", "--tolerance", tolerance)
    assert run.code == 2 and run.err.count("\n") == 1
    assert "--tolerance: expected a number" in run.err


@pytest.mark.parametrize("more", [(), ("--executor", "threads")])
def test_ht_is_refused(lfcal: Lfcal, place: Path, more: tuple[str, ...]) -> None:
    with open_psf(place / "H.h5") as H:
        drain(iter_transpose_file(H, place / "HT.h5"))
    run = lfcal("reduce", "HT.h5", "-o", "out.h5", *more)
    assert run.code == 2 and "got HT; store H, and derive HT from it" in run.err
    assert not (place / "out.h5").exists() and not parts_folder(place / "out.h5").exists()


@pytest.mark.parametrize("more", [(), ("--executor", "threads", "--workers", 1)])
def test_simulated_into_a_small_file(lfcal: Lfcal, place: Path, more: tuple[object, ...]) -> None:
    """As simulated in full and reduced afterwards, and what storage lacks is no miss of the simulation."""
    (place / "plan.json").write_text(small_plan().to_json())
    words = ("simulate", "plan.json", "--level", "geometric", "-o")
    assert lfcal(*words, "full.h5").code == 0
    assert lfcal("reduce", "full.h5", "-o", "reduced.h5", "--tolerance", 0.01).code == 0
    run = lfcal(*words, "small.h5", "--store-tolerance", 0.01, *more)
    assert run.code == 0, run.err
    assert "error including that of storage: " in run.err and "(4 % allowed)" in run.err
    two, one = (contents(place / name) for name in ("reduced.h5", "small.h5"))
    for found in (two, one):  # but for the tasks that made them
        known = json.loads(found["@provenance"])
        found["@provenance"] = {key: known[key] for key in known.keys() - {"task", "earlier_tasks"}}
    assert one == two
    for other in (("--progressive", "-o", "o.h5"), ("--frames", "frames")):
        refused = lfcal("simulate", "plan.json", *other, "--store-tolerance", 0.01)
        assert refused.code == 2 and "--store-tolerance: expected H in one pass, got" in refused.err
    assert lfcal(*words, "o.h5", "--store-tolerance", 2).code == 2
