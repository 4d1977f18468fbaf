"""``lfcal views``: from a white image or a camera alone, of whole frames and parts, by lens type and colour."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.lattice import extract_views, lattice_of, refocus, sensor_slope
from tests.lattice.white_frames import draw_white

SHAPE = (330, 400)
STACKS = ["views.tif", "focal_stack.tif"]
PICTURES = ["views.png", "central_view.png"]


def make_camera() -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 80.0, 400.0, types, 0.003, (-1.0, 1.5), clear_um=70.0, type_step=2)
    return Camera("three", MainLens(), lattice, Sensor(SHAPE, 5.0))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write white, dark and light-field frames of a three-type camera, grey, in colour and as a mosaic."""
    folder = tmp_path_factory.mktemp("views")
    white = draw_white(SHAPE, pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, step=2).frame
    tifffile.imwrite(folder / "white.tif", white)
    tifffile.imwrite(folder / "dark.tif", np.full(SHAPE, 100, np.uint16))
    light = np.random.default_rng(0).integers(500, 4000, SHAPE).astype(np.uint16)
    tifffile.imwrite(folder / "field.tif", light)
    tifffile.imwrite(folder / "part.tif", light[30:230, 40:300])
    tifffile.imwrite(folder / "colour.tif", np.stack([4 * light, 2 * light, light], -1), photometric="rgb")
    mosaic = np.full(SHAPE, 300, np.uint16)
    mosaic[0::2, 1::2], mosaic[1::2, 0::2] = 900, 150
    tifffile.imwrite(folder / "mosaic.tif", mosaic)
    (folder / "camera.json").write_text(make_camera().to_json())
    return folder


def test_views_of_a_white_image(lfcal: Any, files: Path, tmp_path: Path) -> None:
    given = (files / "field.tif", "--white", files / "white.tif", "--dark", files / "dark.tif")
    run = lfcal(
        "views", *given, "-o", tmp_path / "out", "--slopes", "-2,0,2", "--samples", "2", "--json", "--pitch", "15.9"
    )
    assert run.code == 0, run.err
    data = json.loads(run.out)
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
    table = lfcal("views", *given, "--kind", "hexagonal")
    assert table.code == 0 and "of the field" in table.out and "written" not in table.out


def test_views_of_a_described_camera_alone(lfcal: Any, files: Path, tmp_path: Path) -> None:
    run = lfcal("views", files / "field.tif", "--camera", files / "camera.json", "-o", tmp_path, "--slopes", "3")
    assert run.code == 0 and "no white image: clear aperture of" in run.out, run.err
    frame = tifffile.imread(files / "field.tif")
    wanted = extract_views(frame, lattice_of(make_camera()), radius_px=16.0 * np.sqrt(3) / 4)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "views.tif"), wanted.images)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "focal_stack.tif"), refocus(wanted, [3.0], samples=4)[0])


@pytest.mark.long
def test_a_part_of_the_sensor_needs_its_place(lfcal: Any, files: Path) -> None:
    given = ("views", files / "part.tif", "--camera", files / "camera.json", "--json")
    refused = lfcal(*given)
    assert refused.code == 2 and "330 rows and 400 columns of the sensor, got 200 rows and 260 columns" in refused.err
    whole = json.loads(lfcal("views", files / "field.tif", *given[2:]).out)
    for more in ((), ("--white", files / "white.tif")):
        part = json.loads(lfcal(*given, *more, "--origin", "30,40").out)
        assert part["lattice"]["pitch_px"] == pytest.approx(16.0, abs=0.01)
        down = part["fields"]["all"]["corner_px"][0] + 30 - whole["fields"]["all"]["corner_px"][0]
        # rows of the part are rows of the whole field: both lie on lenslets
        assert down / whole["step_px"][0] == pytest.approx(round(down / whole["step_px"][0]), abs=0.15)


def test_axes_and_full_field(lfcal: Any, files: Path, tmp_path: Path) -> None:
    camera = make_camera().to_dict()
    camera["lattice"]["rotation_rad"] = 0.5
    (tmp_path / "turned.json").write_text(json.dumps(camera))
    given = ("views", files / "field.tif", "--camera", tmp_path / "turned.json", "--json")
    upright, turned, full = (
        json.loads(lfcal(*given, *more).out)
        for more in ((), ("--axes", "lattice"), ("--axes", "lattice", "--full", "-o", tmp_path, "--slopes", "0"))
    )
    assert upright["rotation_rad"] == 0.0 and turned["rotation_rad"] == 0.5
    assert upright["fields"]["all"]["kept"] > 0.95 > turned["fields"]["all"]["kept"]
    assert full["fields"]["all"]["kept"] == 1.0 and full["fields"]["all"]["masked"] > 0
    assert np.isnan(tifffile.imread(tmp_path / "views.tif")).any()


@pytest.mark.long
def test_lens_types(lfcal: Any, files: Path, tmp_path: Path) -> None:
    given = ("views", files / "field.tif", "--camera", files / "camera.json", "--slopes", "2,3")
    run = lfcal(*given, "--types", "each", "-o", tmp_path / "each", "--samples", "1")
    assert run.code == 0 and "type 2" in run.out, run.err
    stacks = [tifffile.imread(tmp_path / f"each/focal_stack_type{k}.tif") for k in range(3)]
    assert not np.allclose(stacks[0], stacks[1])
    run = lfcal(*given, "--white", files / "white.tif", "--types", "together", "-o", tmp_path / "all", "--workers", "1")
    assert run.code == 0, run.err
    slopes = tifffile.imread(tmp_path / "all/slopes.tif")
    assert set(np.unique(slopes)) == {2.0, 3.0}
    assert tifffile.imread(tmp_path / "all/all_in_focus.tif").shape == slopes.shape
    assert (tmp_path / "all/all_in_focus.png").exists()


@pytest.mark.long
@pytest.mark.parametrize("more", [(), ("--white",)])
def test_colours(lfcal: Any, files: Path, tmp_path: Path, more: tuple[str, ...]) -> None:
    white = [*more, *([files / "colour.tif"] if more else [])]
    if more:
        bright = tifffile.imread(files / "white.tif")
        white[1] = tmp_path / "white.tif"
        tifffile.imwrite(white[1], np.stack([bright] * 3, -1), photometric="rgb")
    given = ("views", files / "colour.tif", "--camera", files / "camera.json", *white, "--slopes", "3")
    refused = lfcal(*given)
    assert refused.code == 2 and "--channel each" in refused.err
    run = lfcal(*given, "--channel", "each", "-o", tmp_path / "each")
    assert run.code == 0 and "R, G, B" in run.out, run.err
    views = tifffile.imread(tmp_path / "each/views.tif")
    assert views.shape[2] == 3
    np.testing.assert_allclose(views[:, :, 0], 4 * views[:, :, 2], rtol=1e-5)
    assert tifffile.imread(tmp_path / "each/focal_stack.tif").shape[0] == 3
    blue, green, red = cv2.split(cv2.imread(str(tmp_path / "each/central_view.png")))
    assert red.mean() > green.mean() > blue.mean()
    run = lfcal(*given, "--channel", "G", "-o", tmp_path / "one")
    assert run.code == 0, run.err
    np.testing.assert_allclose(tifffile.imread(tmp_path / "one/views.tif"), views[:, :, 1], rtol=1e-6)


def test_a_mosaic_has_its_colours(lfcal: Any, files: Path, tmp_path: Path) -> None:
    given = ("views", files / "mosaic.tif", "--camera", files / "camera.json", "--cfa", "GRBG", "--slopes", "3")
    assert lfcal(*given, "-o", tmp_path).code == 0
    views = tifffile.imread(tmp_path / "views.tif")
    np.testing.assert_allclose(views.mean((0, 1, 3, 4)), [900, 300, 150], rtol=1e-3)


def test_depths_are_the_slopes_of_the_camera(lfcal: Any, files: Path, tmp_path: Path) -> None:
    given = (files / "field.tif", "--camera", files / "camera.json", "-o", tmp_path, "--depths=-20mm,30mm")
    assert lfcal("views", *given).code == 0
    wanted = {f"focus_{sensor_slope(make_camera(), z):+07.2f}.png" for z in (-20e3, 30e3)}
    assert {path.name for path in tmp_path.glob("focus_*.png")} == wanted


def test_bad_input_is_one_line_and_leaves_nothing(lfcal: Any, files: Path, tmp_path: Path) -> None:
    field, white, camera, out = files / "field.tif", files / "white.tif", files / "camera.json", tmp_path / "out"
    for arguments in (
        (field,),
        (files / "absent.tif", "--white", white),
        (field, "--white", field),
        (field, "--white", white, "--depths", "1mm"),
        (field, "--white", white, "--slopes", "a"),
        (field, "--white", white, "--samples", "0"),
        (field, "--white", white, "--types", "each"),
        (field, "--white", white, "--axes", "up"),
        (field, "--white", white, "--channel", "R"),
        (field, "--white", white, "--channel", "X"),
        (field, "--white", files / "colour.tif"),
        (field, "--camera", camera, "--types", "together", "--slopes", "0,2"),
        (field, "--camera", camera, "--types", "some"),
        (field, "--camera", camera, "--origin", "1"),
        (field, "--camera", camera, "--origin", "1,0"),
        (field, "--camera", camera, "--cfa", "GRB"),
        (field, "--camera", camera, "--dark", files / "part.tif"),
        (field, "--camera", "lfm_20x05"),
    ):
        run = lfcal("views", *arguments, "-o", out)
        assert run.code == 2 and run.out == "", arguments
        assert len(run.err.strip().splitlines()) == 1 and run.err.startswith("lfcal: "), run.err
        assert not out.exists()


def test_a_lattice_is_measured_once(lfcal: Any, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    white = files / "white.tif"
    assert lfcal("white", white, "--dark", files / "dark.tif", "-o", tmp_path / "out").code == 0
    given = ("views", files / "field.tif", "--dark", files / "dark.tif", "--slopes", "0")
    lattice = ("--lattice", tmp_path / "out/lattice.json")
    assert lfcal(*given, "--white", white, "-o", tmp_path / "fitted").code == 0
    monkeypatch.setattr("lfcal.lattice.fit_lattice", None)  # nothing is fitted any more
    both = lfcal(*given, "--white", white, *lattice, "-o", tmp_path / "both")
    assert both.code == 0 and "of lattice.json, light of white.tif" in both.out, both.err
    wanted = tifffile.imread(tmp_path / "fitted/views.tif")
    np.testing.assert_allclose(tifffile.imread(tmp_path / "both/views.tif"), wanted, rtol=1e-5)
    alone = lfcal(*given, *lattice, "-o", tmp_path / "alone")
    assert alone.code == 0 and "no white image" in alone.out, alone.err
    assert tifffile.imread(tmp_path / "alone/views.tif").shape[2:] == wanted.shape[2:]
    camera = ("--camera", files / "camera.json")
    for wrong, said in (
        (("--kind", "square"), "--kind: expected"),
        (("--pitch", "16"), "--pitch: expected"),
        ((*camera, "--types", "each"), "add --white"),
    ):
        run = lfcal(*given, *lattice, *wrong)
        assert run.code == 2 and said in run.err and len(run.err.strip().splitlines()) == 1


def test_pixels_without_a_value_are_interpolated(lfcal: Any, files: Path, tmp_path: Path) -> None:
    """NaN and masked pixels of the frame and of the white image leave lattice and views nearly as they were."""
    field, white = (tifffile.imread(files / f"{name}.tif").astype(np.float32) for name in ("field", "white"))
    smooth = np.float32(1000) + 0 * field
    for name, frame in (("smooth", smooth), ("white", white)):
        tifffile.imwrite(tmp_path / f"{name}.tif", frame)
        frame[100:102, 150], frame[200, 210] = np.nan, 60000
        tifffile.imwrite(tmp_path / f"{name}_bad.tif", frame)
    (tmp_path / "mask.csv").write_text("row,column\n# bright\n200,210\n")
    lost = np.zeros(SHAPE, np.uint8)
    lost[200, 210] = 1
    tifffile.imwrite(tmp_path / "mask.tif", lost)
    found = {}
    for name, words in {"": (), "_bad": ("--mask", tmp_path / "mask.csv")}.items():
        given = (tmp_path / f"smooth{name}.tif", "--white", tmp_path / f"white{name}.tif", *words)
        run = lfcal("views", *given, "--full", "-o", tmp_path / f"out{name}")
        assert run.code == 0, run.err
        assert run.err.count("interpolated pixels (masked, or without a finite value): 3") == (2 if name else 0)
        found[name] = tifffile.imread(tmp_path / f"out{name}/views.tif")
        words = ("white", tmp_path / f"white{name}.tif", *(("--mask", tmp_path / "mask.tif") if name else ()), "--json")
        found[f"pitch{name}"] = json.loads(lfcal(*words).out)["pitch_px"]
    np.testing.assert_array_equal(np.isnan(found["_bad"]), np.isnan(found[""]))
    np.testing.assert_allclose(found["_bad"], found[""], rtol=0.03)
    assert abs(found["pitch_bad"] - found["pitch"]) < 1e-3
    (tmp_path / "mask.csv").write_text("row,column\n2000,210\n")
    refused = lfcal("views", *given, "-o", tmp_path / "none")
    assert refused.code == 2 and "2000,210; correct this pixel in the list" in refused.err
