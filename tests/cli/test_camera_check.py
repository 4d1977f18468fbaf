"""``lfcal camera check``: what does not fit the white image is written on demand alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from tests.cli.conftest import Run
from tests.lattice.white_frames import draw_white

SHAPE = (230, 270)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a white image and a camera of a fifth longer pitch."""
    root = tmp_path_factory.mktemp("check")
    truth = draw_white(SHAPE, pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.004)
    tifffile.imwrite(root / "white.tif", truth.frame)
    tifffile.imwrite(root / "dark.tif", np.full(SHAPE, 100, np.uint16))
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 100.0, 400.0, types, 0.004, (-1.0, 1.5))
    (root / "camera.json").write_text(Camera("c", MainLens(), lattice, Sensor(SHAPE, 5.0)).to_json())
    return root


def words(folder: Path, *options: object) -> tuple[object, ...]:
    names = (folder / "camera.json", folder / "white.tif", "--dark", folder / "dark.tif", "--workers", "2")
    return ("camera", "check", *names, *options)


def test_a_camera_that_does_not_fit_is_written_on_demand_alone(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "measured.json"
    done = lfcal(*words(folder, "-o", out))
    assert done.code == 1 and "does not fit" in done.out and not out.exists()
    assert "nothing written: camera and white image do not match" in done.err and "--anyway" in done.err
    done = lfcal(*words(folder, "-o", out, "--json"))
    assert done.code == 1 and done.json["written"] is None and not out.exists()  # type: ignore[index]
    done = lfcal(*words(folder, "-o", out, "--anyway"))
    assert done.code == 0 and "do not match" not in done.err
    measured = Camera.from_json(out.read_text())
    assert measured.pitch_px == pytest.approx(16.0, abs=0.01) and measured.marks["lattice.pitch_um"] == "measured"


def test_what_has_no_measured_lattice_is_refused_even_so(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    camera = Camera.from_json((folder / "camera.json").read_text())
    other = tmp_path / "other.json"
    other.write_text(replace(camera, sensor=Sensor((100, 100), 5.0)).to_json())
    done = lfcal("camera", "check", other, folder / "white.tif", "-o", tmp_path / "m.json", "--anyway")
    assert done.code == 2 and "sensor of the white image" in done.err and not (tmp_path / "m.json").exists()


@pytest.fixture(scope="module")
def fitting(folder: Path) -> Path:
    """Return a camera that the white image fits, with lens types told apart by place and order."""
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 80.0, 400.0, types, 0.004, (-1.0, 1.5))
    path = folder / "fitting.json"
    path.write_text(Camera("c", MainLens(), lattice, Sensor(SHAPE, 5.0)).to_json())
    return path


def test_a_mirrored_white_image_is_called_so_and_no_camera_written(
    lfcal: Callable[..., Run], folder: Path, fitting: Path, tmp_path: Path
) -> None:
    mirrored, out = tmp_path / "mirrored.tif", tmp_path / "measured.json"
    tifffile.imwrite(mirrored, tifffile.imread(folder / "white.tif")[:, ::-1].copy())
    words = ("camera", "check", fitting, mirrored, "--dark", folder / "dark.tif", "--workers", "2", "-o", out)
    done = lfcal(*words)
    assert done.code == 1 and not out.exists()
    assert "the frames are mirrored left to right" in done.err and "σ" in done.err
    assert "--orientation mirror-x, here, in lfcal plan and in lfcal assemble" in done.err
    assert lfcal(*words, "--json").json["turned"] == ["mirror-x"]  # type: ignore[index, call-overload]
    done = lfcal(*words, "--orientation", "mirror-x")
    assert done.code == 0 and "mirrored" not in done.err and out.exists(), done.err
    upright = tmp_path / "upright.json"
    assert (
        lfcal("camera", "check", fitting, folder / "white.tif", "--dark", folder / "dark.tif", "-o", upright).code == 0
    )
    ours, theirs = (Camera.from_json(path.read_text()).lattice for path in (out, upright))
    assert ours.rotation_rad == pytest.approx(theirs.rotation_rad, abs=1e-5) and ours.type_step == theirs.type_step
    assert ours.offset_um == pytest.approx(theirs.offset_um, abs=0.05)


def test_dark_and_white_frames_may_be_folders(
    lfcal: Callable[..., Run], folder: Path, fitting: Path, tmp_path: Path
) -> None:
    """As `lfcal assemble` takes them: the means of all frames in the folder."""
    for name in ("white", "dark"):
        (tmp_path / name).mkdir()
        frame = tifffile.imread(folder / f"{name}.tif")
        for k, change in enumerate((0, 6)):
            tifffile.imwrite(tmp_path / name / f"{k}.tif", frame + np.uint16(change))
    single, several = tmp_path / "a.json", tmp_path / "b.json"
    assert (
        lfcal("camera", "check", fitting, folder / "white.tif", "--dark", folder / "dark.tif", "-o", single).code == 0
    )
    done = lfcal("camera", "check", fitting, tmp_path / "white", "--dark", tmp_path / "dark", "-o", several)
    assert done.code == 0, done.err
    assert Camera.from_json(several.read_text()).lattice == Camera.from_json(single.read_text()).lattice
    done = lfcal("white", tmp_path / "white", "--dark", tmp_path / "dark", "-o", tmp_path / "out")
    assert done.code == 0, done.err
    (tmp_path / "none").mkdir()
    done = lfcal("camera", "check", fitting, folder / "white.tif", "--dark", tmp_path / "none")
    assert done.code == 2 and "expected at least one image" in done.err


def test_a_white_image_of_a_part_of_the_sensor(
    lfcal: Callable[..., Run], folder: Path, fitting: Path, tmp_path: Path
) -> None:
    part, out = tmp_path / "part.tif", tmp_path / "m.json"
    tifffile.imwrite(part, tifffile.imread(folder / "white.tif")[17:, 40:230])
    words = ("camera", "check", fitting, part, "-o", out)
    done = lfcal(*words)
    assert done.code == 2 and "sensor of the white image" in done.err and "--origin ROW,COLUMN" in done.err
    done = lfcal(*words, "--origin", "18,40")
    assert done.code == 2 and "a position on the sensor of 230 x 270 px, got 18,40 for 213 x 190 px" in done.err
    done = lfcal(*words, "--origin", "17,40")
    assert done.code == 0, done.err
    assert Camera.from_json(out.read_text()).sensor.shape == SHAPE
    done = lfcal(*words, "--origin", "17,40", "--orientation", "mirror-x", "--force")
    assert done.code == 2 and "as-is with --origin" in done.err


def test_masked_pixels_of_a_part_of_the_sensor(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    """The list counts rows and columns on the sensor, the frame starts at --origin."""
    white = tifffile.imread(folder / "white.tif").astype(np.float32)[10:, 20:]
    tifffile.imwrite(tmp_path / "whole.tif", white)
    white[90, 80], white[91, 80] = np.nan, 60000
    tifffile.imwrite(tmp_path / "bad.tif", white)
    (tmp_path / "mask.csv").write_text("row,column\n101,100\n")
    found = []
    for name, more in (("whole", ()), ("bad", ("--mask", tmp_path / "mask.csv"))):
        given = ("camera", "check", folder / "camera.json", tmp_path / f"{name}.tif", "--origin", "10,20", *more)
        done = lfcal(*given, "--json")
        assert done.code == 1 and ("without a finite value): 2" in done.err) == bool(more), done.err
        found.append(done.json["camera"]["lattice"]["pitch_um"])  # type: ignore[index]
    assert found[0] == pytest.approx(found[1], abs=5e-3)
