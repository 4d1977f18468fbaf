"""``lfcal depth``: maps and point clouds from a camera, a white image, a lattice or H; refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, ScanPlan, Sensor
from lfcal.lattice import sensor_slope
from lfcal.psf import save
from lfcal.simulate import simulate_psf
from tests.lattice.fourier_scenes import SIDE, SURFACES, camera_of, instrument, scene, white_of
from tests.lattice.plenoptic_scenes import draw, plane

SHAPE = (230, 260)
OFFSET = (0.3, -0.2)
SLOPE = 3.0


def make_camera(rotation: float = 0.02) -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    offset = (5.0 * OFFSET[1], 5.0 * OFFSET[0])
    lattice = LensletLattice("hexagonal", 110.0, 400.0, types, rotation, offset, clear_um=105.0)
    return Camera("three", MainLens(), lattice, Sensor(SHAPE, 5.0))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write frames of a plane at slope 3, grey, in colour, as a mosaic and with NaN, and what belongs to them."""
    folder = tmp_path_factory.mktemp("depth")
    drawn = draw(SHAPE, 22.0, plane(SLOPE), rotation=0.02, focus=(2.0, 3.0, 5.0), noise=0.01, offset=OFFSET)
    frame = np.clip(np.rint(drawn.frame), 0, 65535).astype(np.uint16)
    tifffile.imwrite(folder / "frame.tif", frame + np.uint16(50))
    tifffile.imwrite(folder / "dark.tif", np.full(SHAPE, 50, np.uint16))
    tifffile.imwrite(folder / "white.tif", np.rint(drawn.white + 50).astype(np.uint16))
    tifffile.imwrite(folder / "part.tif", (frame + np.uint16(50))[20:200, 30:250])
    tifffile.imwrite(folder / "colour.tif", np.stack([frame, 2 * frame, frame], -1), photometric="rgb")
    holes = np.array(frame, np.float32)
    holes[100:140, 100:150] = np.nan
    tifffile.imwrite(folder / "holes.tif", holes)
    np.save(folder / "mask.npy", np.isnan(holes))
    (folder / "camera.json").write_text(make_camera().to_json())
    return folder


def measure(lfcal: Any, *words: Any) -> dict[str, Any]:
    run = lfcal("depth", *words, "--json")
    assert run.code == 0, run.err
    found: dict[str, Any] = json.loads(run.out)
    return found


def test_a_camera_gives_depths_in_micrometres(lfcal: Any, files: Path, tmp_path: Path) -> None:
    given = (files / "frame.tif", "--camera", files / "camera.json", "--dark", files / "dark.tif")
    found = measure(lfcal, *given, "-o", tmp_path / "depth.tif", "--cloud", tmp_path / "points.ply")
    camera = make_camera()
    wanted = camera.depth_of(SLOPE * 0.99)
    assert found["method"] == "micro-images" and found["unit"] == "um" and found["known"] > 0.9
    assert abs(sensor_slope(camera, found["depths"][1]) - SLOPE) < 0.05 and wanted < 0
    with tifffile.TiffFile(tmp_path / "depth.tif") as file:
        pages, facts = file.asarray(), file.imagej_metadata or {}
    assert facts["Labels"][:3] == ["depth (um)", "standard error of the depth (um)", "confidence (1)"]
    assert pages.dtype == np.float32 and list(pages.shape[1:]) == found["shape"]
    assert np.isnan(pages[0]).mean() == pytest.approx(1 - found["known"], abs=1e-6)
    assert f"element vertex {found['points']}\n".encode() in (tmp_path / "points.ply").read_bytes()
    table = lfcal("depth", *given, "--out", tmp_path / "depth.tif", "--force")
    assert table.code == 0 and "micro-images" in table.out and "µm, median" in table.out and "written:" in table.out


def test_a_white_image_or_a_lattice_gives_slopes(lfcal: Any, files: Path, tmp_path: Path) -> None:
    white = ("--white", files / "white.tif", "--dark", files / "dark.tif")
    found = measure(lfcal, files / "frame.tif", *white, "-o", tmp_path / "a.tif")
    assert found["unit"] == "slope" and found["depths"][1] == pytest.approx(SLOPE, abs=0.05) and not found["scale"]
    assert lfcal("white", files / "white.tif", "--dark", files / "dark.tif", "-o", tmp_path).code == 0
    lattice = ("--lattice", tmp_path / "lattice.json", "--slopes", "1.5,12", "--workers", "1")
    again = measure(lfcal, files / "frame.tif", *lattice, "-o", tmp_path / "b.tif", "--method", "micro-images")
    assert again["depths"][1] == pytest.approx(SLOPE, abs=0.05)
    plain = lfcal("depth", files / "frame.tif", *lattice, "-o", tmp_path / "c.tif")
    assert plain.code == 0 and "give --camera or --psf" in plain.out


def test_a_part_of_the_sensor(lfcal: Any, files: Path, tmp_path: Path) -> None:
    part = measure(
        lfcal, files / "part.tif", "--camera", files / "camera.json", "--origin", "20,30", "-o", tmp_path / "a.tif"
    )
    assert abs(sensor_slope(make_camera(), part["depths"][1]) - SLOPE) < 0.05
    white = ("--white", files / "white.tif", "--origin", "20,30")
    both = measure(lfcal, files / "part.tif", *white, "-o", tmp_path / "b.tif")
    assert both["depths"][1] == pytest.approx(SLOPE, abs=0.06)


def test_colours(lfcal: Any, files: Path, tmp_path: Path) -> None:
    given = (files / "colour.tif", "--camera", files / "camera.json")
    mean = measure(lfcal, *given, "-o", tmp_path / "mean.tif")
    green = measure(lfcal, *given, "--channel", "G", "-o", tmp_path / "green.tif")
    assert mean["known"] > 0.9 and mean["depths"] == pytest.approx(green["depths"], rel=0.01)
    mosaic = measure(lfcal, files / "frame.tif", *given[1:], "--cfa", "GRBG", "-o", tmp_path / "mosaic.tif")
    assert abs(sensor_slope(make_camera(), mosaic["depths"][1]) - SLOPE) < 0.1


def test_nan_and_a_mask_leave_pixels_out(lfcal: Any, files: Path, tmp_path: Path) -> None:
    camera = ("--camera", files / "camera.json")
    holes = measure(lfcal, files / "holes.tif", *camera, "-o", tmp_path / "holes.tif")
    assert abs(sensor_slope(make_camera(), holes["depths"][1]) - SLOPE) < 0.05
    dark = ("--dark", files / "dark.tif")
    measure(lfcal, files / "frame.tif", *camera, *dark, "--mask", files / "mask.npy", "-o", tmp_path / "mask.tif")
    a, b = (tifffile.imread(tmp_path / f"{name}.tif")[0] for name in ("holes", "mask"))
    np.testing.assert_allclose(a, b, rtol=1e-3)


@pytest.mark.long
def test_h_corrects_a_wrong_camera(lfcal: Any, files: Path, tmp_path: Path) -> None:
    true = make_camera()
    save(simulate_psf(ScanPlan.for_camera(true, virtual_depths=(2.5, 3.0, 4.0))), tmp_path / "H.h5")
    wrong = replace(true, lattice=replace(true.lattice, gap_um=1.06 * true.lattice.gap_um))
    (tmp_path / "wrong.json").write_text(wrong.to_json())
    given = (files / "frame.tif", "--dark", files / "dark.tif")
    found = {
        name: measure(lfcal, *given, *words, "-o", tmp_path / f"{name}.tif")["depths"][1]
        for name, words in {
            "true": ("--camera", files / "camera.json"),
            "wrong": ("--camera", tmp_path / "wrong.json"),
            "corrected": ("--camera", tmp_path / "wrong.json", "--psf", tmp_path / "H.h5"),
            "H alone": ("--psf", tmp_path / "H.h5"),
        }.items()
    }
    off = {name: abs(depth - found["true"]) for name, depth in found.items()}
    assert off["corrected"] < 0.3 * off["wrong"] and off["H alone"] < 0.3 * off["wrong"], off


@pytest.fixture(scope="module")
def fourier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the frame of a Fourier light-field microscope, its white image and its camera."""
    folder, at = tmp_path_factory.mktemp("fourier"), instrument()
    tifffile.imwrite(folder / "frame.tif", scene(at, SURFACES["plane"]).astype(np.float32) + np.float32(100))
    tifffile.imwrite(folder / "white.tif", white_of(at).astype(np.float32) + np.float32(100))
    tifffile.imwrite(folder / "dark.tif", np.full((SIDE, SIDE), 100, np.uint16))
    (folder / "camera.json").write_text(camera_of(at).to_json())
    return folder


def test_a_fourier_microscope(lfcal: Any, fourier: Path, tmp_path: Path) -> None:
    given = (fourier / "frame.tif", "--camera", fourier / "camera.json", "--dark", fourier / "dark.tif")
    words = ("--white", fourier / "white.tif", "-o", tmp_path / "depth.tif", "--cloud", tmp_path / "points.ply")
    found = measure(lfcal, *given, *words)
    assert found["method"] == "views" and found["unit"] == "um" and found["known"] > 0.6
    # 0.3 px are 2 µm
    assert found["depths"] == pytest.approx([12, 12, 12], abs=1.0) and found["depths"][1] == pytest.approx(12, abs=0.2)
    pages = tifffile.imread(tmp_path / "depth.tif")
    assert list(pages.shape) == [5, *found["shape"]] and (tmp_path / "points.ply").is_file()
    for more, word in (
        (("--method", "micro-images"), "method: expected none for a Fourier"),
        (("--lattice", fourier / "camera.json"), "lattice: expected none for a Fourier"),
        (("--origin", "300,300"), "a part of the 400 rows and 400 columns"),
    ):
        refused = lfcal("depth", *given, *more, "-o", tmp_path / "no.tif")
        assert refused.code == 2 and word in refused.err and not (tmp_path / "no.tif").exists(), refused.err


def test_h_corrects_the_scale_of_a_fourier_microscope(lfcal: Any, fourier: Path, tmp_path: Path) -> None:
    """The patterns of H, by wave optics, agree with a scene that was drawn by rays."""
    true = Camera.from_json((fourier / "camera.json").read_text())
    save(simulate_psf(ScanPlan.for_camera(true, depths_um=(-24.0, -12.0, 12.0, 24.0))), tmp_path / "H.h5")
    wrong = replace(true, lattice=replace(true.lattice, fourier_um=1.05 * true.lattice.fourier_um))
    (tmp_path / "wrong.json").write_text(wrong.to_json())
    given = (fourier / "frame.tif", "--dark", fourier / "dark.tif", "--white", fourier / "white.tif")
    words = ("--camera", tmp_path / "wrong.json")
    plain = measure(lfcal, *given, *words, "-o", tmp_path / "a.tif")["depths"][1]
    corrected = measure(lfcal, *given, *words, "--psf", tmp_path / "H.h5", "-o", tmp_path / "b.tif")
    alone = measure(lfcal, *given, "--psf", tmp_path / "H.h5", "-o", tmp_path / "c.tif")
    assert abs(plain - 12) > 0.8 and corrected["scale"].endswith("planes of H"), corrected["scale"]
    assert corrected["depths"][1] == pytest.approx(12, abs=0.25) == alone["depths"][1]


def test_bad_input_is_one_line_and_leaves_nothing(lfcal: Any, files: Path, tmp_path: Path) -> None:
    field, camera, out = files / "frame.tif", files / "camera.json", tmp_path / "out.tif"
    for words in (
        (field, "-o", out),
        (files / "absent.tif", "--camera", camera, "-o", out),
        (field, "--camera", camera, "-o", tmp_path / "out.png"),
        (field, "--camera", camera, "-o", out, "--cloud", tmp_path / "points.xyz"),
        (field, "--camera", camera, "-o", out, "--slopes", "0.5,3"),
        (field, "--camera", camera, "-o", out, "--slopes", "a"),
        (field, "--camera", camera, "-o", out, "--method", "stereo"),
        (field, "--camera", camera, "-o", out, "--channel", "R"),
        (field, "--camera", camera, "-o", out, "--origin", "1"),
        (field, "--camera", camera, "-o", out, "--dark", files / "part.tif"),
        (field, "--camera", camera, "-o", out, "--mask", files / "part.tif"),
        (files / "part.tif", "--camera", camera, "-o", out),
        (field, "--camera", camera, "-o", field),
    ):
        run = lfcal("depth", *words)
        assert run.code == 2 and run.out == "", words
        assert len(run.err.strip().splitlines()) == 1 and run.err.startswith("lfcal: "), run.err
    assert not list(tmp_path.iterdir())
