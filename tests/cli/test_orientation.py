"""``lfcal assemble --orientation``: frames as strangers deliver them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.camera import ScanPlan
from lfcal.psf import open_psf
from tests.cli.conftest import Run
from tests.frames.test_orientation import NUMPY
from tests.psf.test_orientation import UNDONE, a_plan, upright

PLAN = a_plan((60, 72), (7, 9), (18.0, 20.0), 2, (25, 25))


@pytest.fixture(scope="module")
def scan() -> tuple[np.ndarray, list[str]]:
    frames, places = upright(PLAN, width=5.0, noise=2.0)
    return frames.astype(np.uint16), [f"z{p.z}_y{p.y}_x{p.x}.tif" for p in places]


def deliver(folder: Path, frames: np.ndarray, names: list[str], name: str, plan: ScanPlan = PLAN) -> Path:
    """Write frames and dark as somebody does whose frames need ``name`` to be upright."""
    done = NUMPY[UNDONE.get(name, name)]
    slope = np.broadcast_to(np.arange(frames.shape[1], dtype=np.uint16)[:, None] + 60, frames.shape[1:])
    for inner in ("frames", "dark"):
        (folder / inner).mkdir(parents=True)
    for frame, file in zip(frames, names, strict=True):
        tifffile.imwrite(folder / "frames" / file, np.ascontiguousarray(done(frame + slope)))
    tifffile.imwrite(folder / "dark" / "dark.tif", np.ascontiguousarray(done(slope + np.uint16(100))))
    (folder / "plan.json").write_text(plan.to_json())
    return folder


@pytest.fixture(scope="module")
def straight(scan: tuple[np.ndarray, list[str]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return deliver(tmp_path_factory.mktemp("straight"), *scan, "as is")


def arguments(folder: Path, out: Path, *more: object) -> tuple[object, ...]:
    return (
        "assemble",
        folder / "frames",
        "--pattern",
        "z{z}_y{y}_x{x}.tif",
        "--dark",
        folder / "dark",
        "-o",
        out,
        *more,
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["rot90", "mirror x", "transpose"])
def test_turned_frames_are_named_refused_and_turned_on_request(
    lfcal: Callable[..., Run], tmp_path: Path, straight: Path, scan: tuple[np.ndarray, list[str]], name: str
) -> None:
    folder, option = deliver(tmp_path / "s", *scan, name), name.replace(" ", "-")
    stopped = lfcal(*arguments(folder, tmp_path / "H.h5"))
    assert stopped.code == 2
    assert f"--orientation {option}" in stopped.err
    assert len(stopped.err.splitlines()) == 1
    assert not (tmp_path / "H.h5").exists()
    found = lfcal(*arguments(folder, tmp_path / "auto.h5", "--orientation", "auto", "--json"))
    assert found.code == 0, found.err
    assert json.loads(found.out)["orientation"]["applied"] == name
    named = lfcal(*arguments(folder, tmp_path / "named.h5", "--orientation", option))
    assert named.code == 0, named.err
    assert f"turned upright ({name})" in named.err
    assert lfcal(*arguments(straight, tmp_path / "true.h5")).code == 0
    with open_psf(tmp_path / "true.h5") as true:
        for made in ("auto.h5", "named.h5"):
            with open_psf(tmp_path / made) as matrix:
                assert np.array_equal(np.asarray(matrix), np.asarray(true))
                assert matrix.provenance["orientation"]["applied"] == name
    assert f"turned upright: {name}" in lfcal("inspect", tmp_path / "auto.h5", "--seconds", 0).out


def test_a_stack_that_matlab_wrote_is_named_transposed(
    lfcal: Callable[..., Run], tmp_path: Path, scan: tuple[np.ndarray, list[str]]
) -> None:
    """``h5write`` of A(row, column, frame) arrives as (frame, column, row): sima#181, tomviz#1808."""
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["A"] = scan[0].transpose(0, 2, 1) + np.uint16(160)
    stack = ("assemble", tmp_path / "scan.h5", "--plan", tmp_path / "plan.json", "--order", "raster")
    stopped = lfcal(*stack, "--black-level", 160, "-o", tmp_path / "H.h5")
    assert (stopped.code, "--orientation transpose" in stopped.err) == (2, True), stopped.err


def test_upright_frames_pass_with_a_record_and_no_word(
    lfcal: Callable[..., Run], tmp_path: Path, straight: Path
) -> None:
    done = lfcal(*arguments(straight, tmp_path / "H.h5"))
    assert done.code == 0
    assert "lie" not in done.err
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.provenance["orientation"]["found"] == "as is"


def test_wrong_frames_are_taken_as_they_are_where_that_is_asked_for(
    lfcal: Callable[..., Run], tmp_path: Path, scan: tuple[np.ndarray, list[str]]
) -> None:
    folder = deliver(tmp_path / "s", *scan, "mirror y")
    assert lfcal(*arguments(folder, tmp_path / "H.h5", "--orientation", "as-is", "--keep-pedestal")).code == 0


def test_a_reversed_scan_is_not_mended_by_turning_frames(
    lfcal: Callable[..., Run], tmp_path: Path, scan: tuple[np.ndarray, list[str]]
) -> None:
    turned, _ = upright(PLAN, width=5.0, noise=2.0, moves=np.diag([1.0, -1.0]))
    folder = deliver(tmp_path / "s", turned.astype(np.uint16), scan[1], "as is")
    for choice in ("check", "auto"):
        done = lfcal(*arguments(folder, tmp_path / "H.h5", "--orientation", choice))
        assert done.code == 2
        assert "x axis of stage or scan is reversed" in done.err
        assert "order of the positions" in done.err


def test_auto_does_not_guess(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    plan = a_plan((60, 60), (1, 1), (29.0, 29.0), 2, (25, 25))
    frames, places = upright(plan, width=5.0, noise=2.0)
    names = [f"z{p.z}_y{p.y}_x{p.x}.tif" for p in places]
    folder = deliver(tmp_path / "s", frames.astype(np.uint16), names, "mirror x", plan)
    done = lfcal(*arguments(folder, tmp_path / "H.h5", "--orientation", "auto"))
    assert done.code == 2
    assert "state the orientation (--orientation)" in done.err
    told = lfcal(*arguments(folder, tmp_path / "H.h5"))
    assert told.code == 0, told.err
    assert "cannot be determined" in told.err


def test_frames_on_their_side_with_an_upright_dark_are_named(
    lfcal: Callable[..., Run], tmp_path: Path, straight: Path, scan: tuple[np.ndarray, list[str]]
) -> None:
    folder = deliver(tmp_path / "s", *scan, "rot90")
    done = lfcal(*arguments(folder, tmp_path / "H.h5", "--dark", straight / "dark"))
    assert done.code == 2
    assert "rotated by 90°" in done.err
    assert "give dark and white frames as the camera delivers them" in done.err


def test_an_unknown_orientation_is_one_line(lfcal: Callable[..., Run], tmp_path: Path, straight: Path) -> None:
    done = lfcal(*arguments(straight, tmp_path / "H.h5", "--orientation", "upside-down"))
    assert done.code == 2
    assert "expected check, auto, as-is, rot90" in done.err


def test_the_colours_of_the_upright_sensor_are_not_taken_for_those_of_turned_frames(
    lfcal: Callable[..., Run], tmp_path: Path, scan: tuple[np.ndarray, list[str]]
) -> None:
    sensor = replace(PLAN.camera.sensor, cfa="RGGB")
    plan = replace(PLAN, camera=replace(PLAN.camera, sensor=sensor))
    folder = deliver(tmp_path / "s", *scan, "mirror x", plan)
    done = lfcal(*arguments(folder, tmp_path / "H.h5", "--orientation", "mirror-x", "--defects"))
    assert done.code == 2
    assert "the plan's upright sensor, RGGB" in done.err
    assert lfcal(*arguments(folder, tmp_path / "H.h5", "--orientation", "mirror-x")).code == 0
