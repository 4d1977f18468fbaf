"""Every option of ``lfcal assemble`` does something for every kind of source, or is refused with the reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from lfcal.acquire.options import Options
from lfcal.acquire.session import record
from lfcal.camera import ScanPlan
from lfcal.devices import simulated_rig
from lfcal.psf import open_psf
from tests.acquire.rigs import small_plan
from tests.cli.conftest import ANCHOR, DARK, SENSOR, Run

PLAN = small_plan((3, 4), 2)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a session with darks, and what options may name beside it."""
    root = tmp_path_factory.mktemp("recorded")
    record(root / "s", PLAN, simulated_rig(PLAN), Options(darks=2, reference_every=0))
    sensor = PLAN.camera.sensor.shape
    rng = np.random.default_rng(0)
    np.save(root / "dark.npy", rng.integers(60, 70, sensor).astype(np.uint16))
    slope = np.linspace(500, 4000, sensor[1])
    np.save(root / "white.npy", np.broadcast_to(slope, sensor).astype(np.uint16))
    hot = rng.integers(0, sensor[0], (40, 2)) * [1, sensor[1] / sensor[0]]
    np.savetxt(root / "hot.txt", hot, "%d", ",")
    lost = np.zeros(sensor, np.uint8)
    lost[::9, ::9] = 255
    cv2.imwrite(str(root / "lost.png"), lost)
    moved = replace(PLAN, anchor=(PLAN.anchor[0] + 1, PLAN.anchor[1]), cutout=(15, 15))
    (root / "moved.json").write_text(moved.to_json())
    np.save(root / "small.npy", np.zeros((3, 4)))
    (root / "other.json").write_text(small_plan((5, 5), 2).to_json())
    return root


def h_of(path: Path) -> np.ndarray:
    with open_psf(path) as matrix:
        return np.asarray(matrix)


CHANGES = {
    "dark": ("--dark", "dark.npy"),
    "no dark": ("--dark", "none", "--black-level", "0"),
    "black level": ("--black-level", "30"),
    "white by pixels": ("--white", "white.npy", "--white-mode", "pixels", "--dark", "dark.npy"),
    "white floor": ("--white", "white.npy", "--white-mode", "pixels", "--white-floor", "0.9", "--dark", "dark.npy"),
    "background": ("--background", "50"),
    "exposure": ("--exposure", "0.01"),
    "defect list": ("--defect-list", "hot.txt"),
    "mask": ("--mask", "lost.png"),
    "cutout": ("--cutout", "11"),
    "cutout by energy": ("--cutout", "auto", "--lost", "0.2"),
    "plan": ("--plan", "moved.json"),
    "pad": ("--cutout", "31", "--pad"),
    "tolerance": ("--store-tolerance", "0.05"),
}


@pytest.mark.parametrize("case", CHANGES)
@pytest.mark.few(8)
def test_options_change_the_h_of_a_recorded_session(
    lfcal: Callable[..., Run], recorded: Path, tmp_path: Path, case: str
) -> None:
    arguments = [str(recorded / a) if (recorded / a).exists() else a for a in CHANGES[case]]
    plain, changed = tmp_path / "plain.h5", tmp_path / "changed.h5"
    done = lfcal("assemble", recorded / "s", "-o", plain)
    assert done.code == 0, done.err
    done = lfcal("assemble", recorded / "s", "-o", changed, *arguments)
    assert done.code == 0, done.err
    a, b = h_of(plain), h_of(changed)
    assert a.shape != b.shape or not np.array_equal(a, b)


def test_masked_pixels_are_not_valid_in_h(lfcal: Callable[..., Run], recorded: Path, tmp_path: Path) -> None:
    done = lfcal("assemble", recorded / "s", "-o", tmp_path / "H.h5", "--mask", recorded / "lost.png")
    assert done.code == 0, done.err
    lost = cv2.imread(str(recorded / "lost.png"), cv2.IMREAD_UNCHANGED) > 0
    (nt, ns), (row, column) = PLAN.cutout, (int(np.floor(n)) for n in PLAN.anchor)
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.provenance["corrections"]["steps"][0]["kind"] == "mask"
        for y, x in np.ndindex(3, 4):
            top, left = row + y - nt // 2, column + x - ns // 2
            np.testing.assert_array_equal(matrix.valid(0, y, x), ~lost[top : top + nt, left : left + ns])
            assert np.isfinite(np.asarray(matrix[0, y, x])).all()


REFUSED = {
    "dark that is not there": (("--dark", "/nonexistent.tif"), "no such file or folder"),
    "plan that is not there": (("--plan", "/nonexistent.json"), "No such file"),
    "plan of another scan": (("--plan", "other.json"), "expected the plan of these frames"),
    "manifest": (("--manifest", "moved.json"), "the source defines this itself"),
    "pattern": (("--pattern", "z{z}_y{y}_x{x}.png"), "the source defines this itself"),
    "order": (("--order", "raster"), "the source defines this itself"),
    "channel": (("--channel", "G1"), "colour"),
    "defects": (("--defects",), "expected whole sensor frames, got cutouts"),
    "mask of another sensor": (("--mask", "small.npy"), "as the frames come from the camera, got 3 x 4"),
    "measured background": (("--background", "border"), "expected a constant for cutouts"),
    "field of the white image": (("--white", "white.npy", "--dark", "dark.npy"), "--white-mode pixels"),
    "white mode": (("--white", "white.npy", "--white-mode", "smooth"), "expected field or pixels"),
    "cutout": (("--cutout", "61"), "move the anchor, choose a smaller cutout, or allow padding"),
    "no number": (("--cutout", "wide"), "--cutout: expected one number or two (rows,columns)"),
    "shift": (("--shift", "4"), "samples with 4 empty low bits"),
    "level that stays": (("--dark", "none", "--plan", "level.json"), "subtract dark frames, the black level"),
    "interpolation": (("--interpolation", "quintic"), "nearest, linear, cubic or fourier"),
    "dtype": (("--dtype", "int3"), "--dtype: expected rounded or float32"),
    "compression": (("--compression", "rar"), "gzip, zstd or none"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_done_for_a_session_is_refused(
    lfcal: Callable[..., Run], recorded: Path, tmp_path: Path, case: str
) -> None:
    level = replace(PLAN, camera=replace(PLAN.camera, sensor=replace(PLAN.camera.sensor, black_level=0.0)))
    (tmp_path / "level.json").write_text(level.to_json())
    arguments, words = REFUSED[case]
    near = {name: folder / name for folder in (recorded, tmp_path) for name in arguments if (folder / name).exists()}
    done = lfcal("assemble", recorded / "s", "-o", tmp_path / "H.h5", *(near.get(a, a) for a in arguments))
    assert done.code == 2 and words in done.err and len(done.err.splitlines()) == 1, done.err
    assert not (tmp_path / "H.h5").exists()


def test_saturation_interpolation_compression_and_workers(
    lfcal: Callable[..., Run], recorded: Path, tmp_path: Path
) -> None:
    out = tmp_path / "H.h5"
    low = lfcal("assemble", recorded / "s", "-o", out, "--saturation", "200", "--json")
    assert low.code == 0 and low.json["saturated_positions"] == 24  # type: ignore[index,call-overload]
    for options in (("--interpolation", "cubic"), ("--compression", "zstd"), ("--workers", "1"), ("--strict",)):
        done = lfcal("assemble", recorded / "s", "-o", tmp_path / "again.h5", "--force", *options)
        assert done.code == 0, done.err
    assert lfcal("assemble", recorded / "s", "-o", out, "--force", "--compression", "zstd").code == 0
    with h5py.File(out) as file:
        assert file["H"].id.get_create_plist().get_filter(1)[0] == 32015


def test_keep_pedestal_and_shift_of_a_folder(lfcal: Callable[..., Run], session: Path, tmp_path: Path) -> None:
    for path in (session / "frames").glob("*.png"):
        frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), (frame // 16 + 60).astype(np.uint16) << 4)
    refused = lfcal("assemble", session / "frames", "-o", tmp_path / "H.h5", "--shift", "4")
    assert refused.code == 2 and "a constant level of 6" in refused.err
    kept = lfcal("assemble", session / "frames", "-o", tmp_path / "H.h5", "--shift", "4", "--keep-pedestal")
    assert kept.code == 0, kept.err
    assert 60 < h_of(tmp_path / "H.h5").max() < 2000, "the low bits are gone"


def test_order_and_manifest_of_a_folder(lfcal: Callable[..., Run], session: Path, tmp_path: Path) -> None:
    assert lfcal("assemble", session / "frames", "-o", tmp_path / "a.h5").code == 0
    listed = tmp_path / "list.csv"
    (session / "frames" / "manifest.csv").rename(listed)
    done = lfcal("assemble", session / "frames", "-o", tmp_path / "b.h5")
    assert done.code == 0 and "names: read as --pattern 'z{z}_y{y}_x{x}.png'" in done.err
    done = lfcal("assemble", session / "frames", "-o", tmp_path / "b.h5", "--manifest", listed, "--force")
    assert done.code == 0, done.err
    done = lfcal("assemble", session / "frames", "-o", tmp_path / "c.h5", "--order", "raster")
    assert done.code == 0, done.err
    for name in ("b.h5", "c.h5"):
        np.testing.assert_array_equal(h_of(tmp_path / name), h_of(tmp_path / "a.h5"))


def test_channel_of_a_mosaic(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    """A red channel has half the pixels: the plan is that of the channel's sensor."""
    from tests.cli.conftest import small_plan as plan_of_folder

    plan = plan_of_folder()
    frames = tmp_path / "frames"
    frames.mkdir()
    lines = ["file,z,y,x"]
    for z, y, x in np.ndindex(*plan.shape[:3]):
        r, c = np.mgrid[: SENSOR[0], : SENSOR[1]]
        red = 20000 * np.exp(-((r - ANCHOR[0] - y) ** 2 + (c - ANCHOR[1] - x) ** 2) / 6.0)
        mosaic = np.full((2 * SENSOR[0], 2 * SENSOR[1]), 40000, np.uint16)
        mosaic[0::2, 1::2] = np.rint(red)
        mosaic[1::2, 0::2] = 3
        cv2.imwrite(str(frames / f"{z}{y}{x}.png"), mosaic)
        lines.append(f"{z}{y}{x}.png,{z},{y},{x}")
    entries = [dict(zip(("file", "z", "y", "x"), line.split(","), strict=True)) for line in lines[1:]]
    import json

    (frames / "manifest.json").write_text(json.dumps({"frames": entries, "cfa": "GRBG"}))
    (tmp_path / "plan.json").write_text(plan.to_json())
    done = lfcal("assemble", frames, "-o", tmp_path / "H.h5", "--channel", "R", "--plan", tmp_path / "plan.json")
    assert done.code == 0, done.err
    H = h_of(tmp_path / "H.h5")
    assert H.max() == pytest.approx(20000, rel=1e-3)
    assert H[0, 0, 0, 4, 5] == H[0, 0, 0].max(), "centred on the point"


def test_a_plan_alone_is_recorded_by_the_simulated_camera(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    plan = ScanPlan.for_camera(PLAN.camera, virtual_depths=[4.0], cutout=21)
    (tmp_path / "plan.json").write_text(replace(plan, period=(2, 3)).to_json())
    done = lfcal("assemble", tmp_path / "plan.json", "-o", tmp_path / "H.h5", "--json")
    assert done.code == 0, done.err
    found: Any = done.json
    assert (found["frames"], found["unknown_saturation"], found["saturated_positions"]) == (6, 0, 0)
    assert DARK and h_of(tmp_path / "H.h5").shape == (1, 2, 3, 21, 21)
