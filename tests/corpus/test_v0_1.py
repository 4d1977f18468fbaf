"""Files that lfcal 0.1 wrote open in every later version, and hold what they held then."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire import RedoList
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.fit.stored import read_fit
from lfcal.frames import open_frames
from lfcal.lattice import load_lattice
from lfcal.psf import PSFMatrix, open_psf, regions_of, save, verify
from lfcal_gui.models.project import read_project

FILES = Path(__file__).parent / "v0_1"
EXPECTED = json.loads((FILES / "expected.json").read_text())
MATRICES = [(name, found["region"]) for name, all_of_it in EXPECTED["matrices"].items() for found in all_of_it]


def expected_of(name: str, region: str) -> dict[str, Any]:
    return next(found for found in EXPECTED["matrices"][name] if found["region"] == region)


def assert_as_written(matrix: PSFMatrix, wanted: dict[str, Any]) -> None:
    upright = matrix.T if matrix.is_transposed else matrix
    assert matrix.is_transposed == wanted["transposed"]
    assert matrix.depths.tolist() == wanted["depths_um"] and list(matrix.anchor) == wanted["anchor"]
    assert matrix.camera == preset(wanted["camera"])
    for z, total in enumerate(wanted["plane_sums"]):
        assert matrix.plane(z).sum(dtype=np.float64) == pytest.approx(total, rel=1e-6)
        # version 1 stated the sums of the values before they were rounded
        assert matrix.depth_sum(z).sum() == pytest.approx(total, rel=1e-5)
    for place, pattern in wanted["patterns"].items():
        at = tuple(int(k) for k in place.split(","))
        assert np.allclose(matrix[at], pattern, rtol=1e-6, atol=1e-7 * np.max(pattern)), place
    assert upright.recorded.tolist() == wanted["recorded"]
    for fact in {"saturated", "noise", "spread", "error", "origin", "bound"} & wanted.keys():
        stated = np.array(wanted[fact], np.float64)
        assert np.allclose(np.ravel(getattr(upright.facts, fact)), stated, rtol=1e-6, equal_nan=True), fact
    if "uncertainty" in wanted:
        assert matrix.stated_uncertainty is not None
        # rounded up wherever it is written, by at most 1 %
        ratio = matrix.stated_uncertainty.cutout(0, 1, 1) / np.array(wanted["uncertainty"])
        assert ratio.min() >= 1 - 1e-6 and ratio.max() < 1.01
        assert np.array_equal(matrix.valid(0, 1, 1), np.array(wanted["valid"], bool))


@pytest.mark.parametrize(("name", "region"), MATRICES)
def test_an_h_file_opens_and_holds_its_values(name: str, region: str) -> None:
    with open_psf(FILES / name, region=region) as matrix:
        assert_as_written(matrix, expected_of(name, region))


@pytest.mark.parametrize("name", sorted(EXPECTED["matrices"]))
def test_an_h_file_is_whole(name: str) -> None:
    assert regions_of(FILES / name) == tuple(found["region"] for found in EXPECTED["matrices"][name])
    check = verify(FILES / name)
    assert check.ok, check.deviations


@pytest.mark.parametrize(("name", "region"), MATRICES)
def test_an_h_file_is_written_again_with_the_same_values(name: str, region: str, tmp_path: Path) -> None:
    with open_psf(FILES / name, region=region) as matrix:
        save(matrix, tmp_path / "again.h5")
    with open_psf(tmp_path / "again.h5") as matrix:
        assert_as_written(matrix, expected_of(name, region))
    assert verify(tmp_path / "again.h5").ok


def test_no_file_of_the_corpus_is_left_out() -> None:
    assert {path.name for path in FILES.glob("*.h5")} == EXPECTED["matrices"].keys()


def test_a_session_opens_with_its_frames(tmp_path: Path) -> None:
    folder = shutil.copytree(FILES / "session", tmp_path / "session")  # opening may leave a lock
    wanted = EXPECTED["session"]
    with open_frames(folder) as frames:
        assert list(frames.shape) == wanted["shape"]
        assert [list(frames.info(k).position) for k in range(len(frames))] == wanted["positions"]
        assert [int(frames.read(k).sum()) for k in range(len(frames))] == wanted["sums"]
        assert frames.read(0)[:3, :3].tolist() == wanted["corner"]


def test_descriptions_open() -> None:
    camera = Camera.from_json((FILES / "camera.json").read_text())
    assert camera == preset("lfm_20x05")
    plan = ScanPlan.from_json((FILES / "plan.json").read_text())
    assert plan.shape == (2, 2, 2, 9, 11) and plan.anchor == (20.0, 24.0) and plan.camera.name == "bench"
    state = read_project(FILES / "project.lfcal")
    assert state.plan == plan and state.redo == ((0, 0, 1),) and state.settings == {"frames": {"strict": True}}
    assert [tuple(p) for p in RedoList.read(FILES / "redo.json").positions] == [(0, 0, 1), (1, 1, 0)]
    lattice = load_lattice(FILES / "lattice.json")
    assert (lattice.pitch_px, lattice.kind) == (pytest.approx(11.99730557), "hexagonal")


def test_a_fit_opens() -> None:
    fit = read_fit(FILES / "fit")
    assert fit.period == (19, 33) and fit.setup.camera.lattice.gap_um == pytest.approx(290.321, abs=1e-3)
    assert np.isfinite(fit.gains).all() and 0 < fit.error < 0.1
