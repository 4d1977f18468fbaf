"""Turned and mirrored frames: named, turned upright on request, and with lists of stage coordinates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.camera import LensletLattice, ScanPlan, StageAxes
from lfcal.psf import open_psf
from tests.cli.conftest import Lfcal, Run
from tests.frames.test_orientation import NUMPY
from tests.psf.test_orientation import UNDONE, a_plan, upright

PLAN = a_plan((60, 72), (7, 9), (18.0, 20.0), 2, (25, 25))
Scan = tuple[np.ndarray, list[str]]


def scan_of(plan: ScanPlan, moves: np.ndarray | None = None) -> Scan:
    """Return frames of a scan, and names that state their positions."""
    frames, places = upright(plan, width=5.0, noise=2.0, moves=moves)
    return frames.astype(np.uint16), [f"z{p.z}_y{p.y}_x{p.x}.tif" for p in places]


@pytest.fixture(scope="module")
def scan() -> Scan:
    return scan_of(PLAN)


@pytest.fixture(scope="module")
def truth(scan: Scan) -> np.ndarray:
    """Return H of upright frames, cut out by hand."""
    found = np.zeros(PLAN.shape, np.float32)
    for (z, y, x), frame in zip(np.ndindex(*PLAN.shape[:3]), scan[0], strict=True):
        row, column = int(PLAN.anchor[0]) + y, int(PLAN.anchor[1]) + x
        found[z, y, x] = frame[row - 12 : row + 13, column - 12 : column + 13]
    return found


def same(out: Path, truth: np.ndarray) -> bool:
    with open_psf(out) as matrix:
        return float(np.abs(np.asarray(matrix) - truth).max()) < 1e-3 * float(truth.max())


# -- frames whose names state their positions -----------------------------------------------------------------
def deliver(folder: Path, scan: Scan, name: str, plan: ScanPlan = PLAN) -> Path:
    """Write frames that need ``name`` to be upright, and their dark frame."""
    (frames, names), turn = scan, NUMPY[UNDONE.get(name, name)]
    slope = np.broadcast_to(np.arange(frames.shape[1], dtype=np.uint16)[:, None] + 60, frames.shape[1:])
    for inner in ("frames", "dark"):
        (folder / inner).mkdir(parents=True)
    for frame, file in zip(frames, names, strict=True):
        tifffile.imwrite(folder / "frames" / file, np.ascontiguousarray(turn(frame + slope)))
    tifffile.imwrite(folder / "dark" / "dark.tif", np.ascontiguousarray(turn(slope + np.uint16(100))))
    (folder / "plan.json").write_text(plan.to_json())
    return folder


def arguments(folder: Path, out: Path, *more: object) -> tuple[object, ...]:
    named = ("--pattern", "z{z}_y{y}_x{x}.tif", "--dark", folder / "dark")
    return ("assemble", folder / "frames", *named, "-o", out, *more)


@pytest.mark.parametrize(
    "name", ["rot90", *(pytest.param(n, marks=pytest.mark.long) for n in ("mirror x", "transpose"))]
)
def test_turned_frames_are_named_refused_and_turned_on_request(
    lfcal: Lfcal, tmp_path: Path, scan: Scan, truth: np.ndarray, name: str
) -> None:
    folder, option = deliver(tmp_path / "s", scan, name), name.replace(" ", "-")
    lfcal(*arguments(folder, tmp_path / "H.h5")).refused(f"--orientation {option}")
    assert not (tmp_path / "H.h5").exists()
    for choice, out in (("auto", tmp_path / "auto.h5"), (option, tmp_path / "named.h5")):
        run = lfcal(*arguments(folder, out, "--orientation", choice)).ok()
        assert (choice == "auto" or f"turned upright ({name})" in run.err) and same(out, truth - 100)
        with open_psf(out) as matrix:
            assert matrix.provenance["orientation"]["applied"] == name
    assert f"turned upright: {name}" in lfcal("inspect", tmp_path / "auto.h5", "--seconds", 0).out


def test_a_stack_that_matlab_wrote_is_named_transposed(lfcal: Lfcal, tmp_path: Path, scan: Scan) -> None:
    """``h5write`` of A(row, column, frame) arrives as (frame, column, row): sima#181, tomviz#1808."""
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["A"] = scan[0].transpose(0, 2, 1) + np.uint16(160)
    stack = ("assemble", tmp_path / "scan.h5", "--plan", tmp_path / "plan.json", "--order", "raster")
    lfcal(*stack, "--black-level", 160, "-o", tmp_path / "H.h5").refused("--orientation transpose")


def test_frames_that_are_not_turned(lfcal: Lfcal, tmp_path: Path, scan: Scan) -> None:
    """Upright frames pass with a record and without a note; others on request; a reversed scan needs other help."""
    folder = deliver(tmp_path / "s", scan, "as is")
    assert "lie" not in lfcal(*arguments(folder, tmp_path / "H.h5")).ok().err
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.provenance["orientation"]["found"] == "as is"
    wrong = lfcal(*arguments(folder, tmp_path / "W.h5", "--orientation", "upside-down"))
    wrong.refused("expected check, auto, as-is, rot90")
    mirrored = deliver(tmp_path / "m", scan, "mirror y")
    lfcal(*arguments(mirrored, tmp_path / "M.h5", "--orientation", "as-is", "--keep-pedestal")).ok()
    reversed_scan = deliver(tmp_path / "r", scan_of(PLAN, np.diag([1.0, -1.0])), "as is")
    for choice in ("check", "auto"):
        run = lfcal(*arguments(reversed_scan, tmp_path / "R.h5", "--orientation", choice))
        run.refused("x axis of stage or scan is reversed", "order of the positions")


def test_auto_does_not_guess(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = a_plan((60, 60), (1, 1), (29.0, 29.0), 2, (25, 25))
    folder = deliver(tmp_path / "s", scan_of(plan), "mirror x", plan)
    run = lfcal(*arguments(folder, tmp_path / "H.h5", "--orientation", "auto"))
    run.refused("state the orientation (--orientation)")
    assert "cannot be determined" in lfcal(*arguments(folder, tmp_path / "H.h5")).ok().err


def test_turned_frames_with_an_upright_dark_are_named(lfcal: Lfcal, tmp_path: Path, scan: Scan) -> None:
    folder = deliver(tmp_path / "s", scan, "rot90")
    dark = tifffile.imread(folder / "dark" / "dark.tif")
    tifffile.imwrite(folder / "dark" / "dark.tif", np.ascontiguousarray(np.rot90(dark)))
    run = lfcal(*arguments(folder, tmp_path / "H.h5"))
    run.refused("rotated by 90°", "give dark and white frames as the camera delivers them")


def mosaic(folder: Path, scan: Scan) -> Path:
    """Write mirrored frames and the plan of a colour sensor."""
    plan = replace(PLAN, camera=replace(PLAN.camera, sensor=replace(PLAN.camera.sensor, cfa="RGGB")))
    return deliver(folder, scan, "mirror x", plan)


def test_colours_of_the_upright_sensor_are_not_those_of_turned_frames(lfcal: Lfcal, tmp_path: Path, scan: Scan) -> None:
    words = arguments(mosaic(tmp_path / "s", scan), tmp_path / "H.h5", "--orientation", "mirror-x")
    lfcal(*words, "--defects").refused("the plan's upright sensor, RGGB")


@pytest.mark.long
def test_turned_frames_of_colours_are_assembled_without_defects(lfcal: Lfcal, tmp_path: Path, scan: Scan) -> None:
    lfcal(*arguments(mosaic(tmp_path / "s", scan), tmp_path / "H.h5", "--orientation", "mirror-x")).ok()


# -- frames with a list of stage coordinates ------------------------------------------------------------------
TURNED = [pytest.param(name, marks=[] if name == "rot90" else pytest.mark.long) for name in NUMPY if name != "as is"]
MOUNTED = StageAxes("-x", "+y", "+z", origin_um=(4321.0, -250.0, 17.0))


def listed(folder: Path, scan: Scan, name: str, plan: ScanPlan = PLAN, stage: StageAxes | None = None) -> Path:
    """Write frames that need ``name``, the list of a ``stage``, and the plan."""
    folder.mkdir(parents=True)
    places = np.array(list(np.ndindex(*plan.shape[:3])))
    at = replace(plan, stage=stage or plan.stage).stage_um(places)
    rows = ["file,x_um,y_um,z_um"]
    for k, (frame, (x, y, z)) in enumerate(zip(scan[0], at, strict=True)):
        tifffile.imwrite(folder / f"shot{k:03d}.tif", np.ascontiguousarray(NUMPY[UNDONE.get(name, name)](frame)))
        rows.append(f"shot{k:03d}.tif,{x:.4f},{y:.4f},{z:.4f}")
    (folder / "stage.csv").write_text("\n".join(rows))
    (folder / "plan.json").write_text(plan.to_json())
    return folder


def assembled(lfcal: Lfcal, folder: Path, out: Path, choice: str) -> Run:
    words = ("--black-level", "0", "--keep-pedestal", "-o", out, "--orientation", choice, "--json", "--force")
    return lfcal("assemble", folder, *words)


@pytest.mark.parametrize("name", TURNED)
def test_turned_frames_of_a_list_are_named_and_turned_once(
    lfcal: Lfcal, tmp_path: Path, scan: Scan, truth: np.ndarray, name: str
) -> None:
    folder, option, out = listed(tmp_path / "s", scan, name), name.replace(" ", "-"), tmp_path / "H.h5"
    stopped = assembled(lfcal, folder, out, "check")
    assert stopped.code == 2 and f"--orientation {option}" in stopped.err.splitlines()[-1] and not out.exists()
    for choice in ("auto", option):
        done = assembled(lfcal, folder, out, choice).ok()
        assert done.json["orientation"]["applied"] == name and same(out, truth) and "the plan says" not in done.err


@pytest.mark.parametrize("name", ["as is", *(pytest.param(n, marks=pytest.mark.long) for n in ("mirror x", "rot90"))])
def test_the_mount_of_a_stage_is_not_mistaken_for_the_orientation_of_frames(
    lfcal: Lfcal, tmp_path: Path, scan: Scan, truth: np.ndarray, name: str
) -> None:
    folder = listed(tmp_path / "s", scan, name, stage=MOUNTED)
    done = assembled(lfcal, folder, tmp_path / "H.h5", name.replace(" ", "-")).ok()
    assert "axes: -x,+y,+z move the image" in done.err and same(tmp_path / "H.h5", truth)
    for choice in ("check", "auto") if name == "as is" else ():
        assembled(lfcal, folder, tmp_path / "H.h5", choice).ok()
        assert same(tmp_path / "H.h5", truth)


def test_where_both_look_the_same_the_note_says_so(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = replace(PLAN, anchor=(26.0, 31.0))  # the scan is in the middle of the sensor
    folder = listed(tmp_path / "s", scan_of(plan), "mirror x", plan)
    done = assembled(lfcal, folder, tmp_path / "H.h5", "check").ok()
    said = "if the plan is right, the frames are mirrored left to right (--orientation mirror-x)"
    assert said in done.err and done.json["orientation"]["applied"] == "as is"
    done = assembled(lfcal, folder, tmp_path / "H.h5", "auto").ok()
    assert done.json["orientation"]["applied"] == "mirror x"


def test_a_plan_is_made_from_turned_frames(lfcal: Lfcal, tmp_path: Path, scan: Scan) -> None:
    folder, camera = listed(tmp_path / "s", scan, "rot180"), PLAN.camera
    pixel, lens = camera.sensor.pixel_um, camera.lattice
    array = LensletLattice("square", 9 * pixel, lens.gap_um, lens.types[:1], row_pitch_um=7 * pixel)
    (tmp_path / "camera.json").write_text(replace(camera, lattice=array).to_json())
    words = ("--positions", folder / "stage.csv", "--frames", folder, "--cutout", "25", "-o", tmp_path / "plan.json")
    lfcal("plan", tmp_path / "camera.json", *words, "--orientation", "rot180").ok()
    made = ScanPlan.from_json((tmp_path / "plan.json").read_text())
    assert made.period == PLAN.period and made.anchor == pytest.approx(PLAN.anchor, abs=0.5)
