"""``lfcal views`` and ``lfcal depth``: from white images, cameras, lattices or H."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, ScanPlan, Sensor
from lfcal.lattice import extract_views, lattice_of, refocus, sensor_slope
from lfcal.psf import save
from lfcal.simulate import simulate_psf
from tests.cli.conftest import Lfcal
from tests.lattice.fourier_scenes import SIDE, SURFACES, camera_of, instrument, scene, white_of
from tests.lattice.plenoptic_scenes import draw, plane
from tests.lattice.white_frames import draw_white

# -- ``lfcal views``: from a white image or a camera alone, of whole frames and parts, by lens type and colour --
VIEWS_SHAPE = (330, 400)
STACKS = ["views.tif", "focal_stack.tif"]
PICTURES = ["views.png", "central_view.png"]


def make_camera() -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 80.0, 400.0, types, 0.003, (-1.0, 1.5), clear_um=70.0, type_step=2)
    return Camera("three", MainLens(), lattice, Sensor(VIEWS_SHAPE, 5.0))


@pytest.fixture(scope="module")
def views_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write white, dark and light-field frames of a three-type camera, grey, in colour and as a mosaic."""
    folder = tmp_path_factory.mktemp("views")
    white = draw_white(VIEWS_SHAPE, pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, step=2).frame
    tifffile.imwrite(folder / "white.tif", white)
    tifffile.imwrite(folder / "dark.tif", np.full(VIEWS_SHAPE, 100, np.uint16))
    light = np.random.default_rng(0).integers(500, 4000, VIEWS_SHAPE).astype(np.uint16)
    tifffile.imwrite(folder / "field.tif", light)
    tifffile.imwrite(folder / "part.tif", light[30:230, 40:300])
    tifffile.imwrite(folder / "colour.tif", np.stack([4 * light, 2 * light, light], -1), photometric="rgb")
    mosaic = np.full(VIEWS_SHAPE, 300, np.uint16)
    mosaic[0::2, 1::2], mosaic[1::2, 0::2] = 900, 150
    tifffile.imwrite(folder / "mosaic.tif", mosaic)
    (folder / "camera.json").write_text(make_camera().to_json())
    return folder


@pytest.fixture
def here(views_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(views_folder)
    return views_folder


def test_views_of_a_white_image(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    given = ("field.tif", "--white", "white.tif", "--dark", "dark.tif")
    words = ("--slopes", "-2,0,2", "--samples", "2", "--pitch", "15.9")
    data = lfcal("views", *given, "-o", tmp_path / "out", *words, "--json").ok().json
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {Path(path).name for path in data["written"]}
    assert names == {*STACKS, *PICTURES, "focus_-002.00.png", "focus_+000.00.png", "focus_+002.00.png"}
    field = data["fields"]["all"]
    views = tifffile.imread(tmp_path / "out/views.tif")
    assert views.shape == (data["views"], data["views"], *field["shape"]) and views.dtype == np.float32
    # dead lenslets show nothing, and say so
    assert field["masked"] == np.isnan(views[0, 0]).sum() > 0
    with tifffile.TiffFile(tmp_path / "out/focal_stack.tif") as tiff:
        assert tiff.is_imagej and tiff.series[0].axes == "ZYX"
        assert tiff.series[0].shape == (3, 2 * field["shape"][0], 2 * field["shape"][1])
        assert tiff.imagej_metadata is not None and tiff.imagej_metadata["Labels"][0] == "slope -2.000"
    with tifffile.TiffFile(tmp_path / "out/views.tif") as tiff:
        assert tiff.is_imagej and tiff.series[0].axes == "TZYX"


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_views_of_a_white_image_are_summarized(lfcal: Lfcal) -> None:
    table = lfcal("views", "field.tif", "--white", "white.tif", "--dark", "dark.tif", "--kind", "hexagonal")
    assert table.code == 0 and "of the field" in table.out and "written" not in table.out


def test_views_of_a_described_camera_alone(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    run = lfcal("views", "field.tif", "--camera", "camera.json", "-o", tmp_path, "--slopes", "3").ok()
    assert "no white image: clear aperture of" in run.out
    frame = tifffile.imread("field.tif")
    wanted = extract_views(frame, lattice_of(make_camera()), radius_px=16.0 * np.sqrt(3) / 4)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "views.tif"), wanted.images)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "focal_stack.tif"), refocus(wanted, [3.0], samples=4)[0])


@pytest.mark.long
def test_a_part_of_the_sensor_needs_its_place(lfcal: Lfcal, here: Path) -> None:
    given = ("views", "part.tif", "--camera", "camera.json", "--json")
    lfcal(*given).refused("330 rows and 400 columns of the sensor, got 200 rows and 260 columns")
    whole = json.loads(lfcal("views", "field.tif", *given[2:]).out)
    for more in ((), ("--white", "white.tif")):
        part = json.loads(lfcal(*given, *more, "--origin", "30,40").out)
        assert part["lattice"]["pitch_px"] == pytest.approx(16.0, abs=0.01)
        down = part["fields"]["all"]["corner_px"][0] + 30 - whole["fields"]["all"]["corner_px"][0]
        # rows of the part are rows of the whole field: both lie on lenslets
        assert down / whole["step_px"][0] == pytest.approx(round(down / whole["step_px"][0]), abs=0.15)


def test_axes_and_full_field(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    camera = make_camera().to_dict()
    camera["lattice"]["rotation_rad"] = 0.5
    (tmp_path / "turned.json").write_text(json.dumps(camera))
    given = ("views", "field.tif", "--camera", tmp_path / "turned.json", "--json")
    upright, turned, full = (
        json.loads(lfcal(*given, *more).out)
        for more in ((), ("--axes", "lattice"), ("--axes", "lattice", "--full", "-o", tmp_path, "--slopes", "0"))
    )
    assert upright["rotation_rad"] == 0.0 and turned["rotation_rad"] == 0.5
    assert upright["fields"]["all"]["kept"] > 0.95 > turned["fields"]["all"]["kept"]
    assert full["fields"]["all"]["kept"] == 1.0 and full["fields"]["all"]["masked"] > 0
    assert np.isnan(tifffile.imread(tmp_path / "views.tif")).any()


@pytest.mark.long
def test_lens_types(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    given = ("views", "field.tif", "--camera", "camera.json", "--slopes", "2,3")
    assert "type 2" in lfcal(*given, "--types", "each", "-o", tmp_path / "each", "--samples", "1").ok().out
    stacks = [tifffile.imread(tmp_path / f"each/focal_stack_type{k}.tif") for k in range(3)]
    assert not np.allclose(stacks[0], stacks[1])
    lfcal(*given, "--white", "white.tif", "--types", "together", "-o", tmp_path / "all", "--workers", "1").ok()
    slopes = tifffile.imread(tmp_path / "all/slopes.tif")
    assert set(np.unique(slopes)) == {2.0, 3.0}
    assert tifffile.imread(tmp_path / "all/all_in_focus.tif").shape == slopes.shape
    assert (tmp_path / "all/all_in_focus.png").exists()


@pytest.mark.long
@pytest.mark.parametrize("white", [(), ("--white", "rgb_white.tif")])
def test_colours_of_an_image(lfcal: Lfcal, here: Path, tmp_path: Path, white: tuple[str, ...]) -> None:
    tifffile.imwrite(here / "rgb_white.tif", np.stack([tifffile.imread("white.tif")] * 3, -1), photometric="rgb")
    given = ("views", "colour.tif", "--camera", "camera.json", *white, "--slopes", "3")
    lfcal(*given).refused("--channel each")
    assert "R, G, B" in lfcal(*given, "--channel", "each", "-o", tmp_path / "each").ok().out
    views = tifffile.imread(tmp_path / "each/views.tif")
    assert views.shape[2] == 3
    np.testing.assert_allclose(views[:, :, 0], 4 * views[:, :, 2], rtol=1e-5)
    assert tifffile.imread(tmp_path / "each/focal_stack.tif").shape[0] == 3
    blue, green, red = cv2.split(cv2.imread(str(tmp_path / "each/central_view.png")))
    assert red.mean() > green.mean() > blue.mean()
    lfcal(*given, "--channel", "G", "-o", tmp_path / "one").ok()
    np.testing.assert_allclose(tifffile.imread(tmp_path / "one/views.tif"), views[:, :, 1], rtol=1e-6)


def test_colours_of_a_mosaic_and_depths_as_slopes(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    words = ("--camera", "camera.json", "--depths=-20mm,30mm", "-o", tmp_path)
    lfcal("views", "mosaic.tif", *words, "--cfa", "GRBG").ok()
    views = tifffile.imread(tmp_path / "views.tif")
    np.testing.assert_allclose(views.mean((0, 1, 3, 4)), [900, 300, 150], rtol=1e-3)
    wanted = {f"focus_{sensor_slope(make_camera(), z):+07.2f}.png" for z in (-20e3, 30e3)}
    assert {path.name for path in tmp_path.glob("focus_*.png")} == wanted


def test_bad_input_is_one_line_and_leaves_nothing(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    white, camera = "field.tif --white white.tif", "field.tif --camera camera.json"
    of_white = ("--depths 1mm", "--slopes a", "--samples 0", "--types each", "--axes up", "--channel R", "--channel X")
    of_camera = ("--types together --slopes 0,2", "--types some", "--origin 1", "--origin 1,0", "--cfa GRB")
    for words in (
        "field.tif",
        "absent.tif --white white.tif",
        "field.tif --white field.tif",
        "field.tif --white colour.tif",
        *(f"{white} {option}" for option in of_white),
        *(f"{camera} {option}" for option in (*of_camera, "--dark part.tif")),
        "field.tif --camera lfm_20x05",
    ):
        run = lfcal("views", *words.split(), "-o", tmp_path / "out").refused()
        assert run.out == "" and run.err.startswith("lfcal: ") and not (tmp_path / "out").exists(), words


def test_a_lattice_is_used_instead_of_a_white_image(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    lfcal("white", "white.tif", "--dark", "dark.tif", "-o", tmp_path / "out").ok()
    given = ("views", "field.tif", "--dark", "dark.tif", "--slopes", "0")
    lattice = ("--lattice", tmp_path / "out/lattice.json")
    assert "no white image" in lfcal(*given, *lattice, "-o", tmp_path / "alone").ok().out
    for wrong, said in (
        (("--kind", "square"), "--kind: expected"),
        (("--pitch", "16"), "--pitch: expected"),
        (("--camera", "camera.json", "--types", "each"), "add --white"),
    ):
        lfcal(*given, *lattice, *wrong).refused(said)


@pytest.mark.long
def test_a_lattice_is_measured_once(lfcal: Lfcal, here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    white = "white.tif"
    lfcal("white", white, "--dark", "dark.tif", "-o", tmp_path / "out").ok()
    given = ("views", "field.tif", "--dark", "dark.tif", "--slopes", "0")
    lattice = ("--lattice", tmp_path / "out/lattice.json")
    lfcal(*given, "--white", white, "-o", tmp_path / "fitted").ok()
    monkeypatch.setattr("lfcal.lattice.fit_lattice", None)  # nothing is fitted any more
    run = lfcal(*given, "--white", white, *lattice, "-o", tmp_path / "both").ok()
    assert "of lattice.json, light of white.tif" in run.out
    wanted = tifffile.imread(tmp_path / "fitted/views.tif")
    np.testing.assert_allclose(tifffile.imread(tmp_path / "both/views.tif"), wanted, rtol=1e-5)
    assert "no white image" in lfcal(*given, *lattice, "-o", tmp_path / "alone").ok().out
    assert tifffile.imread(tmp_path / "alone/views.tif").shape[2:] == wanted.shape[2:]


def test_pixels_without_a_value_are_interpolated(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    frame = np.full(VIEWS_SHAPE, 1000, np.float32)
    frame[100:102, 150], frame[200, 210] = np.nan, 60000
    tifffile.imwrite(tmp_path / "bad.tif", frame)
    (tmp_path / "mask.csv").write_text("row,column\n# bright\n200,210\n")
    given = ("views", tmp_path / "bad.tif", "--camera", "camera.json", "--mask", tmp_path / "mask.csv")
    run = lfcal(*given, "-o", tmp_path / "out").ok()
    assert "interpolated pixels (masked, or without a finite value): 3" in run.err
    views = tifffile.imread(tmp_path / "out/views.tif")
    np.testing.assert_allclose(views[np.isfinite(views)], 1000, rtol=0.03)
    (tmp_path / "mask.csv").write_text("row,column\n2000,210\n")
    lfcal(*given, "-o", tmp_path / "none").refused("2000,210; correct this pixel in the list")


@pytest.mark.long
def test_pixels_without_a_value_change_neither_lattice_nor_views(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    """NaN and masked pixels of the frame and of the white image leave lattice and views nearly as they were."""
    field, white = (tifffile.imread(f"{name}.tif").astype(np.float32) for name in ("field", "white"))
    smooth = np.float32(1000) + 0 * field
    for name, frame in (("smooth", smooth), ("white", white)):
        tifffile.imwrite(tmp_path / f"{name}.tif", frame)
        frame[100:102, 150], frame[200, 210] = np.nan, 60000
        tifffile.imwrite(tmp_path / f"{name}_bad.tif", frame)
    (tmp_path / "mask.csv").write_text("row,column\n# bright\n200,210\n")
    lost = np.zeros(VIEWS_SHAPE, np.uint8)
    lost[200, 210] = 1
    tifffile.imwrite(tmp_path / "mask.tif", lost)
    found = {}
    for name, words in {"": (), "_bad": ("--mask", tmp_path / "mask.csv")}.items():
        given = (tmp_path / f"smooth{name}.tif", "--white", tmp_path / f"white{name}.tif", *words)
        run = lfcal("views", *given, "--full", "-o", tmp_path / f"out{name}").ok()
        assert run.err.count("interpolated pixels (masked, or without a finite value): 3") == (2 if name else 0)
        found[name] = tifffile.imread(tmp_path / f"out{name}/views.tif")
        words = ("white", tmp_path / f"white{name}.tif", *(("--mask", tmp_path / "mask.tif") if name else ()), "--json")
        found[f"pitch{name}"] = json.loads(lfcal(*words).out)["pitch_px"]
    np.testing.assert_array_equal(np.isnan(found["_bad"]), np.isnan(found[""]))
    np.testing.assert_allclose(found["_bad"], found[""], rtol=0.03)
    assert abs(found["pitch_bad"] - found["pitch"]) < 1e-3


# -- ``lfcal depth``: maps and point clouds from a camera, a white image, a lattice or H; refusals --
DEPTH_SHAPE = (230, 260)
OFFSET = (0.3, -0.2)
SLOPE = 3.0


def make_camera_depth(rotation: float = 0.02) -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    offset = (5.0 * OFFSET[1], 5.0 * OFFSET[0])
    lattice = LensletLattice("hexagonal", 110.0, 400.0, types, rotation, offset, clear_um=105.0)
    return Camera("three", MainLens(), lattice, Sensor(DEPTH_SHAPE, 5.0))


@pytest.fixture(scope="module")
def depth_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write frames of a plane at slope 3, grey, in colour, as a mosaic and with NaN, and what belongs to them."""
    folder = tmp_path_factory.mktemp("depth")
    drawn = draw(DEPTH_SHAPE, 22.0, plane(SLOPE), rotation=0.02, focus=(2.0, 3.0, 5.0), noise=0.01, offset=OFFSET)
    frame = np.clip(np.rint(drawn.frame), 0, 65535).astype(np.uint16)
    tifffile.imwrite(folder / "frame.tif", frame + np.uint16(50))
    tifffile.imwrite(folder / "dark.tif", np.full(DEPTH_SHAPE, 50, np.uint16))
    tifffile.imwrite(folder / "white.tif", np.rint(drawn.white + 50).astype(np.uint16))
    tifffile.imwrite(folder / "part.tif", (frame + np.uint16(50))[20:200, 30:250])
    tifffile.imwrite(folder / "colour.tif", np.stack([frame, 2 * frame, frame], -1), photometric="rgb")
    holes = np.array(frame, np.float32)
    holes[100:140, 100:150] = np.nan
    tifffile.imwrite(folder / "holes.tif", holes)
    np.save(folder / "mask.npy", np.isnan(holes))
    (folder / "camera.json").write_text(make_camera_depth().to_json())
    return folder


@pytest.fixture
def scene_here(depth_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(depth_folder)
    return depth_folder


def measure(lfcal: Lfcal, *words: Any) -> Any:
    return lfcal("depth", *words, "--json").ok().json


def test_a_camera_gives_depths_in_micrometres(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    given = ("frame.tif", "--camera", "camera.json", "--dark", "dark.tif")
    found = measure(lfcal, *given, "-o", tmp_path / "depth.tif", "--cloud", tmp_path / "points.ply")
    camera = make_camera_depth()
    wanted = camera.depth_of(SLOPE * 0.99)
    assert found["method"] == "micro-images" and found["unit"] == "um" and found["known"] > 0.9
    assert abs(sensor_slope(camera, found["depths"][1]) - SLOPE) < 0.05 and wanted < 0
    with tifffile.TiffFile(tmp_path / "depth.tif") as file:
        pages, facts = file.asarray(), file.imagej_metadata or {}
    assert facts["Labels"][:3] == ["depth (um)", "standard error of the depth (um)", "confidence (1)"]
    assert pages.dtype == np.float32 and list(pages.shape[1:]) == found["shape"]
    assert np.isnan(pages[0]).mean() == pytest.approx(1 - found["known"], abs=1e-6)
    assert f"element vertex {found['points']}\n".encode() in (tmp_path / "points.ply").read_bytes()


@pytest.mark.usefixtures("scene_here")
def test_depths_are_summarized(lfcal: Lfcal, tmp_path: Path) -> None:
    given = ("frame.tif", "--camera", "camera.json", "--dark", "dark.tif", "--out", tmp_path / "depth.tif")
    (tmp_path / "depth.tif").write_text("old")
    table = lfcal("depth", *given, "--force")
    assert table.code == 0 and "micro-images" in table.out and "µm, median" in table.out and "written:" in table.out


def test_a_white_image_gives_slopes(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    white = ("--white", "white.tif", "--dark", "dark.tif")
    found = measure(lfcal, "frame.tif", *white, "-o", tmp_path / "a.tif")
    assert found["unit"] == "slope" and found["depths"][1] == pytest.approx(SLOPE, abs=0.05) and not found["scale"]


@pytest.mark.long
def test_a_lattice_gives_slopes(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    lfcal("white", "white.tif", "--dark", "dark.tif", "-o", tmp_path).ok()
    lattice = ("--lattice", tmp_path / "lattice.json", "--slopes", "1.5,12", "--workers", "1")
    again = measure(lfcal, "frame.tif", *lattice, "-o", tmp_path / "b.tif", "--method", "micro-images")
    assert again["depths"][1] == pytest.approx(SLOPE, abs=0.05)
    assert "give --camera or --psf" in lfcal("depth", "frame.tif", *lattice, "-o", tmp_path / "c.tif").ok().out


def test_a_part_of_the_sensor_and_colours(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    def slope(*words: object) -> float:
        found = measure(lfcal, *words, "-o", tmp_path / "a.tif", "--force")["depths"][1]
        return sensor_slope(make_camera_depth(), found) if "--camera" in words else found

    camera = ("--camera", "camera.json")
    assert slope("part.tif", *camera, "--origin", "20,30") == pytest.approx(SLOPE, abs=0.05)
    assert slope("part.tif", "--white", "white.tif", "--origin", "20,30") == pytest.approx(SLOPE, abs=0.06)
    assert slope("frame.tif", *camera, "--cfa", "GRBG") == pytest.approx(SLOPE, abs=0.1)
    mean = measure(lfcal, "colour.tif", *camera, "-o", tmp_path / "mean.tif")
    green = measure(lfcal, "colour.tif", *camera, "--channel", "G", "-o", tmp_path / "green.tif")
    assert mean["known"] > 0.9 and mean["depths"] == pytest.approx(green["depths"], rel=0.01)


def test_nan_and_a_mask_leave_pixels_out(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    camera = ("--camera", "camera.json")
    holes = measure(lfcal, "holes.tif", *camera, "-o", tmp_path / "holes.tif")
    assert abs(sensor_slope(make_camera_depth(), holes["depths"][1]) - SLOPE) < 0.05
    dark = ("--dark", "dark.tif")
    measure(lfcal, "frame.tif", *camera, *dark, "--mask", "mask.npy", "-o", tmp_path / "mask.tif")
    a, b = (tifffile.imread(tmp_path / f"{name}.tif")[0] for name in ("holes", "mask"))
    np.testing.assert_allclose(a, b, rtol=1e-3)


@pytest.mark.long
def test_h_corrects_a_wrong_camera(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    true = make_camera_depth()
    save(simulate_psf(ScanPlan.for_camera(true, virtual_depths=(2.5, 3.0, 4.0))), tmp_path / "H.h5")
    wrong = replace(true, lattice=replace(true.lattice, gap_um=1.06 * true.lattice.gap_um))
    (tmp_path / "wrong.json").write_text(wrong.to_json())
    given = ("frame.tif", "--dark", "dark.tif")
    found = {
        name: measure(lfcal, *given, *words, "-o", tmp_path / f"{name}.tif")["depths"][1]
        for name, words in {
            "true": ("--camera", "camera.json"),
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


@pytest.fixture
def fourier_here(fourier: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(fourier)
    return fourier


def test_a_fourier_microscope(lfcal: Lfcal, fourier_here: Path, tmp_path: Path) -> None:
    given = ("frame.tif", "--camera", "camera.json", "--dark", "dark.tif")
    words = ("--white", "white.tif", "-o", tmp_path / "depth.tif", "--cloud", tmp_path / "points.ply")
    found = measure(lfcal, *given, *words)
    assert found["method"] == "views" and found["unit"] == "um" and found["known"] > 0.6
    # 0.3 px are 2 µm
    assert found["depths"] == pytest.approx([12, 12, 12], abs=1.0) and found["depths"][1] == pytest.approx(12, abs=0.2)
    pages = tifffile.imread(tmp_path / "depth.tif")
    assert list(pages.shape) == [5, *found["shape"]] and (tmp_path / "points.ply").is_file()
    for more, word in (
        (("--method", "micro-images"), "method: expected none for a Fourier"),
        (("--lattice", "camera.json"), "lattice: expected none for a Fourier"),
        (("--origin", "300,300"), "a part of the 400 rows and 400 columns"),
    ):
        refused = lfcal("depth", *given, *more, "-o", tmp_path / "no.tif")
        assert refused.code == 2 and word in refused.err and not (tmp_path / "no.tif").exists(), refused.err


@pytest.mark.long
def test_h_corrects_the_scale_of_a_fourier_microscope(lfcal: Lfcal, fourier_here: Path, tmp_path: Path) -> None:
    """The patterns of H, by wave optics, agree with a scene that was drawn by rays."""
    true = Camera.from_json(Path("camera.json").read_text())
    save(simulate_psf(ScanPlan.for_camera(true, depths_um=(-24.0, -12.0, 12.0, 24.0))), tmp_path / "H.h5")
    wrong = replace(true, lattice=replace(true.lattice, fourier_um=1.05 * true.lattice.fourier_um))
    (tmp_path / "wrong.json").write_text(wrong.to_json())
    given = ("frame.tif", "--dark", "dark.tif", "--white", "white.tif")
    words = ("--camera", tmp_path / "wrong.json")
    plain = measure(lfcal, *given, *words, "-o", tmp_path / "a.tif")["depths"][1]
    corrected = measure(lfcal, *given, *words, "--psf", tmp_path / "H.h5", "-o", tmp_path / "b.tif")
    alone = measure(lfcal, *given, "--psf", tmp_path / "H.h5", "-o", tmp_path / "c.tif")
    assert abs(plain - 12) > 0.8 and corrected["scale"].endswith("planes of H"), corrected["scale"]
    assert corrected["depths"][1] == pytest.approx(12, abs=0.25) == alone["depths"][1]


def test_bad_input_of_depth_is_one_line_and_leaves_nothing(lfcal: Lfcal, scene_here: Path, tmp_path: Path) -> None:
    given = "frame.tif --camera camera.json -o OUT.tif"
    options = ("--slopes 0.5,3", "--slopes a", "--method stereo", "--channel R", "--origin 1", "--dark part.tif")
    for words in (
        "frame.tif -o OUT.tif",
        "absent.tif --camera camera.json -o OUT.tif",
        "part.tif --camera camera.json -o OUT.tif",
        "frame.tif --camera camera.json -o OUT.png",
        "frame.tif --camera camera.json -o frame.tif",
        *(f"{given} {option}" for option in (*options, "--mask part.tif", "--cloud OUT.xyz")),
    ):
        run = lfcal("depth", *words.replace("OUT", str(tmp_path / "out")).split()).refused()
        assert run.out == "" and run.err.startswith("lfcal: ") and not list(tmp_path.iterdir()), words
