"""Turned frames with a list of stage coordinates: what is named is corrected, and nothing twice."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import LensletLattice, ScanPlan, StageAxes
from lfcal.psf import open_psf
from tests.cli.conftest import Run
from tests.frames.test_orientation import NUMPY
from tests.psf.test_orientation import UNDONE, a_plan, upright

PLAN = a_plan((60, 72), (7, 9), (18.0, 20.0), 2, (25, 25))
QUICK = ("rot90", "mirror x")
TURNED = [pytest.param(name, marks=[] if name in QUICK else pytest.mark.long) for name in NUMPY if name != "as is"]
MOUNTED = StageAxes("-x", "+y", "+z", origin_um=(4321.0, -250.0, 17.0))


@pytest.fixture(scope="module")
def pictures() -> np.ndarray:
    frames, _ = upright(PLAN, width=5.0, noise=2.0)
    return frames.astype(np.uint16)


def deliver(folder: Path, frames: np.ndarray, name: str, plan: ScanPlan = PLAN, stage: StageAxes | None = None) -> Path:
    """Write frames that need ``name``, the list of a ``stage``, and the plan."""
    folder.mkdir(parents=True)
    places = np.array(list(np.ndindex(*plan.shape[:3])))
    at = replace(plan, stage=stage or plan.stage).stage_um(places)
    rows = ["file,x_um,y_um,z_um"]
    for k, (frame, (x, y, z)) in enumerate(zip(frames, at, strict=True)):
        tifffile.imwrite(folder / f"shot{k:03d}.tif", np.ascontiguousarray(NUMPY[UNDONE.get(name, name)](frame)))
        rows.append(f"shot{k:03d}.tif,{x:.4f},{y:.4f},{z:.4f}")
    (folder / "stage.csv").write_text("\n".join(rows))
    (folder / "plan.json").write_text(plan.to_json())
    return folder


def assembled(lfcal: Callable[..., Run], folder: Path, out: Path, choice: str) -> Run:
    return lfcal(
        "assemble", folder, "--black-level", "0", "--keep-pedestal", "-o", out, "--orientation", choice, "--json"
    )


@pytest.fixture(scope="module")
def truth(pictures: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Return H of upright frames, cut out by hand."""
    found = np.zeros(PLAN.shape, np.float32)
    for (z, y, x), frame in zip(np.ndindex(*PLAN.shape[:3]), pictures, strict=True):
        row, column = int(PLAN.anchor[0]) + y, int(PLAN.anchor[1]) + x
        found[z, y, x] = frame[row - 12 : row + 13, column - 12 : column + 13]
    return found


def same(out: Path, truth: np.ndarray) -> bool:
    with open_psf(out) as matrix:
        return float(np.abs(np.asarray(matrix) - truth).max()) < 1e-3 * float(truth.max())


@pytest.mark.parametrize("name", TURNED)
def test_turned_frames_are_named_and_turned_once(
    lfcal: Callable[..., Run], tmp_path: Path, pictures: np.ndarray, truth: np.ndarray, name: str
) -> None:
    folder, option = deliver(tmp_path / "s", pictures, name), name.replace(" ", "-")
    stopped = assembled(lfcal, folder, tmp_path / "H.h5", "check")
    assert stopped.code == 2 and f"--orientation {option}" in stopped.err.splitlines()[-1]
    assert not (tmp_path / "H.h5").exists()
    for choice in ("auto", option):
        done = assembled(lfcal, folder, tmp_path / f"{choice}.h5", choice)
        assert done.code == 0, done.err
        assert json.loads(done.out)["orientation"]["applied"] == name
        assert same(tmp_path / f"{choice}.h5", truth)
        assert "the plan says" not in done.err


@pytest.mark.parametrize("name", ["as is", pytest.param("mirror x", marks=pytest.mark.long), "rot90"])
def test_a_stage_mounted_otherwise_is_not_taken_for_the_frames(
    lfcal: Callable[..., Run], tmp_path: Path, pictures: np.ndarray, truth: np.ndarray, name: str
) -> None:
    folder = deliver(tmp_path / "s", pictures, name, stage=MOUNTED)
    done = assembled(lfcal, folder, tmp_path / "H.h5", name.replace(" ", "-"))
    assert done.code == 0, done.err
    assert "axes: -x,+y,+z move the image" in done.err
    assert same(tmp_path / "H.h5", truth)
    if name == "as is":
        for choice in ("check", "auto"):
            done = assembled(lfcal, folder, tmp_path / f"{choice}.h5", choice)
            assert done.code == 0, done.err
            assert same(tmp_path / f"{choice}.h5", truth)


def test_where_both_look_the_same_the_note_says_so(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    plan = replace(PLAN, anchor=(26.0, 31.0))  # the scan is in the middle of the sensor
    frames, _ = upright(plan, width=5.0, noise=2.0)
    folder = deliver(tmp_path / "s", frames.astype(np.uint16), "mirror x", plan)
    taken = assembled(lfcal, folder, tmp_path / "taken.h5", "check")
    assert taken.code == 0, taken.err
    assert "if the plan is right, the frames are mirrored left to right (--orientation mirror-x)" in taken.err
    assert json.loads(taken.out)["orientation"]["applied"] == "as is"
    turned = assembled(lfcal, folder, tmp_path / "turned.h5", "auto")
    assert turned.code == 0, turned.err
    assert json.loads(turned.out)["orientation"]["applied"] == "mirror x"


def test_a_plan_is_made_from_turned_frames(lfcal: Callable[..., Run], tmp_path: Path, pictures: np.ndarray) -> None:
    folder, camera = deliver(tmp_path / "s", pictures, "rot180"), PLAN.camera
    pixel, lens = camera.sensor.pixel_um, camera.lattice
    array = LensletLattice("square", 9 * pixel, lens.gap_um, lens.types[:1], row_pitch_um=7 * pixel)
    (tmp_path / "camera.json").write_text(replace(camera, lattice=array).to_json())
    words = ("--positions", folder / "stage.csv", "--frames", folder, "--cutout", "25", "-o", tmp_path / "plan.json")
    done = lfcal("plan", tmp_path / "camera.json", *words, "--orientation", "rot180")
    assert done.code == 0, done.err
    made = ScanPlan.from_json((tmp_path / "plan.json").read_text())
    assert made.period == PLAN.period and made.anchor == pytest.approx(PLAN.anchor, abs=0.5)
