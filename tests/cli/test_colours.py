"""One scan through a colour filter: an H of each colour, every sample where the mosaic has it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import ArraySource
from lfcal.frames.channels import colour_scan
from lfcal.psf import open_psf
from tests.cli.conftest import Lfcal

SENSOR, ANCHOR, PERIOD = (41, 52), (17.0, 22.0), (4, 6)
CFA = "GRBG"
PLACES = {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}
WIDTH = {"R": 3.0, "G": 5.0, "B": 8.0}


def light(colour: str, place: tuple[float, float]) -> np.ndarray:
    """Return the light of one colour at every pixel: spots of three widths, so that no two colours are alike."""
    r, c = np.mgrid[: SENSOR[0], : SENSOR[1]]
    spot = np.exp(-((r - place[0]) ** 2 + (c - place[1]) ** 2) / WIDTH[colour[0]])
    return np.rint(20000 * spot * {"R": 0.9, "G": 1.0, "B": 0.5}[colour[0]]).astype(np.uint16)


def mosaic(place: tuple[float, float]) -> np.ndarray:
    frame = np.zeros(SENSOR, np.uint16)
    for name, (r, c) in PLACES.items():
        frame[r::2, c::2] = light(name, place)[r::2, c::2]
    return frame


def plan_of(period: tuple[int, int] = PERIOD, cfa: str = CFA, **changes: object) -> ScanPlan:
    camera = preset("bench")
    sensor = replace(camera.sensor, shape=SENSOR, bit_depth=16, black_level=0, cfa=cfa)
    lattice = replace(camera.lattice, offset_um=(7.0, -3.0))
    camera = replace(camera, sensor=sensor, lattice=lattice)
    return replace(ScanPlan(camera, period, (9, 11), (-20e3,), ANCHOR), **changes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("bayer")
    for name in ("frames", "rgb"):
        (root / name).mkdir()
    for y, x in np.ndindex(PERIOD):
        place = (ANCHOR[0] + y, ANCHOR[1] + x)
        cv2.imwrite(str(root / "frames" / f"y{y}_x{x}.png"), mosaic(place))
        colour = np.stack([light(name, place) for name in "RGB"], axis=-1)
        tifffile.imwrite(root / "rgb" / f"y{y}_x{x}.tif", colour, photometric="rgb")
    (root / "plan.json").write_text(plan_of().to_json())
    return root


def h_of(path: Path) -> np.ndarray:
    with open_psf(path) as matrix:
        return np.asarray(matrix)


def test_each_colour_of_a_mosaic(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    done = lfcal(
        "assemble", folder / "frames", "-o", tmp_path / "H.h5", "--channel", "each", "--dtype", "float32", "--json"
    ).ok()
    assert [Path(part["out"]).name for part in json.loads(done.out)] == ["H_G1.h5", "H_R.h5", "H_B.h5", "H_G2.h5"]
    for name, (r0, c0) in PLACES.items():
        H = h_of(tmp_path / f"H_{name}.h5")
        assert H.shape == (1, 2, 3, 5, 7)
        # the same from the definition: the point on a pixel of the colour, its samples every second pixel around
        first = [(r0 - 17) % 2, (c0 - 22) % 2]
        for y, x in np.ndindex(2, 3):
            row, column = 17 + first[0] + 2 * y, 22 + first[1] + 2 * x
            frame = mosaic((row, column))
            assert (row % 2, column % 2) == (r0, c0)
            wanted = frame[row - 4 : row + 5 : 2, column - 6 : column + 7 : 2]
            np.testing.assert_array_equal(H[0, y, x], wanted)


def test_one_colour_is_that_of_each(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    run = lfcal("assemble", folder / "frames", "-o", tmp_path / "R.h5", "--channel", "R").ok()
    assert "6 of 24 frames are used, those whose image point lies on a pixel of this colour" in run.err
    with open_psf(tmp_path / "R.h5") as matrix:
        camera = matrix.camera
    assert camera is not None and camera.sensor.cfa == "" and camera.sensor.shape == (21, 26)
    lfcal("assemble", folder / "frames", "-o", tmp_path / "G.h5", "--channel", "G").refused("expected G1, R, B or G2")
    (tmp_path / "H_R.h5").write_bytes(b"mine")
    kept = lfcal("assemble", folder / "frames", "-o", tmp_path / "H.h5", "--channel", "each")
    assert kept.code == 2 and "H_R.h5: exists" in kept.err and (tmp_path / "H_R.h5").read_bytes() == b"mine"
    assert not (tmp_path / "H_G1.h5").exists()


def test_the_camera_of_a_colour_has_its_lattice_where_it_is() -> None:
    plan = plan_of()
    source = ArraySource(np.zeros((1, *SENSOR), np.uint16), [(0, 0, 0)])
    for name, (r0, c0) in PLACES.items():
        scan = colour_scan(source, plan, name)
        assert scan is not None
        # a point of the sensor in both descriptions: pixel (i, j) of the colour is (r0 + 2 i, c0 + 2 j) of the mosaic
        for i, j in ((0, 0), (5, 9)):
            whole = plan.camera.sensor_um((r0 + 2 * i, c0 + 2 * j)) - np.array(plan.camera.lattice.offset_um)
            own = scan.plan.camera.sensor_um((i, j)) - np.array(scan.plan.camera.lattice.offset_um)
            np.testing.assert_allclose(own, whole, atol=1e-9)
        assert scan.plan.camera.sensor.pixel_um == 2 * plan.camera.sensor.pixel_um
        np.testing.assert_array_equal(np.array(scan.plan.anchor) * 2 + (r0, c0), np.array(ANCHOR) + scan.first)


def test_what_has_no_colours() -> None:
    source = ArraySource(np.zeros((1, *SENSOR), np.uint16), [(0, 0, 0)])
    odd = plan_of((5, 6))
    with pytest.raises(InputError, match="period of channel R: expected a multiple of 2 pixels") as caught:
        colour_scan(source, odd, "R")
    assert "5 x 6 pixels" in str(caught.value)
    # the remedy works: the plan is changed as the message says
    found = re.search(r'set "period" in plan\.json to (\[\d+, \d+\])', str(caught.value))
    assert found is not None and found[1] == "[10, 6]"
    plan = ScanPlan.from_json(json.dumps(json.loads(odd.to_json()) | {"period": json.loads(found[1])}))
    scan = colour_scan(source, plan, "R")
    assert scan is not None and scan.plan.period == (5, 3)
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, cfa=CFA))
    plan = ScanPlan.for_camera(camera, depths_um=[0.0], cutout=5, resample=True)
    whole = ArraySource(np.zeros((1, *camera.sensor.shape), np.uint16), [(0, 0, 0)])
    with pytest.raises(InputError, match="without --resample"):
        colour_scan(whole, plan, "R")


def test_colour_images_and_monochrome_frames(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(plan_of(cfa="").to_json())
    own = ("--plan", tmp_path / "plan.json", "--dtype", "float32", "--force", "-o", tmp_path / "H.h5")
    grey = ("assemble", folder / "frames", *own, "--channel")
    lfcal(*grey, "each").refused("expected colour frames, got monochrome ones")
    lfcal(*grey, "R").refused("expected none for monochrome frames, got 'R'; leave the channel out (--channel)")
    arguments = ("assemble", folder / "rgb", *own)
    lfcal(*arguments).refused("--channel G")
    lfcal(*arguments, "--channel", "each", "--dark", "none").ok()
    for name in "RGB":
        np.testing.assert_array_equal(h_of(tmp_path / f"H_{name}.h5")[0, 0, 0], light(name, ANCHOR)[13:22, 17:28])
    lfcal(*arguments, "--channel", "B").ok()
    np.testing.assert_array_equal(h_of(tmp_path / "H.h5"), h_of(tmp_path / "H_B.h5"))
    dark = np.zeros((*SENSOR, 3), np.uint16) + np.array([1, 2, 3], np.uint16)
    tifffile.imwrite(tmp_path / "dark.tif", dark, photometric="rgb")
    lfcal(*arguments, "--channel", "G", "--dark", tmp_path / "dark.tif").ok()
    np.testing.assert_array_equal(h_of(tmp_path / "H_G.h5") - 2, h_of(tmp_path / "H.h5"))
