"""``lfcal camera``: imported, described, compared with a white image, and its sensor measured."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
import typer

from lfcal.camera import (
    Camera,
    LatticeDistortion,
    LensletLattice,
    LensType,
    MainLens,
    Marks,
    PupilLenslets,
    Sensor,
    preset,
    quantities_of,
)
from tests.camera.importers.files import CONFIGURATION, OLAF, napari
from tests.camera.importers.test_raytrix_xml import REAL, needs_real, xml
from tests.cli.conftest import Lfcal, Run
from tests.frames.photon_transfer.sensor_model import Truth, micro_images
from tests.lattice.white_frames import draw_white

# -- ``lfcal camera`` on first use: what is known, what is assumed, and what the white image says --
SENSOR = ("--sensor", "4384x6576,5.5", "--lens", "200,4,1000")


def read(path: Path) -> Camera:
    return Camera.from_json(path.read_text(encoding="utf-8"))


# -- import -----------------------------------------------------------------------------------------------
def test_import_states_what_the_options_state(lfcal: Lfcal, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    done = lfcal("camera", "import", tmp_path / "c.xml", *SENSOR, "--gap", "900", "-o", tmp_path / "camera.json")
    assert done.code == 0 and "written:" in done.out
    camera = read(tmp_path / "camera.json")
    for path in ("sensor.shape", "sensor.pixel_um", "optics.focal_length_um", "lattice.gap_um"):
        assert camera.marks[path] == "stated"
    assert camera.lattice.gap_um == 900 and camera.pitch_px == pytest.approx(38.3737792969)
    assert camera.marks["sensor.read_noise_e"] == "assumed"
    assert "14 values of light and noise" in done.err and "not applied" in done.err


def test_every_command_names_assumed_values(lfcal: Lfcal, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    plan = tmp_path / "plan.json"
    done = lfcal("plan", tmp_path / "c.xml", "--virtual-depths", "3", "-o", plan).ok()
    lens = "focal length of the main lens 200 mm"
    assert all(said in done.err.splitlines()[0] for said in ("assumed", "pixel pitch 5.5 µm", lens, "--sensor ROWSx"))
    rows = {line.strip(): "assumed" in line for line in done.out.splitlines()}
    for label, assumed in (
        ("lateral step", True),
        ("object-space depth", True),
        ("cell of the lenslet array", False),
        ("virtual depth", False),
    ):
        assert next(found for row, found in rows.items() if row.startswith(label)) == assumed, label
    for words in (("simulate", plan, "--plan-only"), ("acquire", plan, "--out", tmp_path / "s", "--dry-run")):
        assert {"lattice.gap_um", "sensor.pixel_um"} <= set(lfcal(*words, "--json").ok().json["assumed"])
    options = (*SENSOR, "--gap", "900", "--focus", "2,3,5", "-o", tmp_path / "k.json")
    lfcal("camera", "import", tmp_path / "c.xml", *options).ok()
    sure = lfcal("plan", tmp_path / "k.json", "--virtual-depths", "3")
    assert "(from assumed" not in sure.out and not sure.err, "a plan does not depend on values of light and noise"


def test_files_of_other_programs(lfcal: Lfcal, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "f.tif", np.zeros((40, 52), np.uint16))
    out = tmp_path / "c.json"
    micromanager = ("--resolution", "Res40x", "--pitch", "20px", "--sensor", "1400x1500,6.5")
    for name, text, options, pitch in (
        ("o.yaml", OLAF, (), 112 / 6.5),
        ("metadata.txt", napari(), (), 125 / 7.4),
        ("m.json", napari(), ("--frame", tmp_path / "f.tif"), 125 / 7.4),
        ("mm.cfg", CONFIGURATION, micromanager, 20.0),
    ):
        (tmp_path / name).write_text(text)
        words = ("camera", "import", tmp_path / name, *options, "--name", "mine", "--json", "--force", "-o", out)
        done, camera = lfcal(*words).ok(), read(out)
        assert camera.pitch_px == pytest.approx(pitch) and camera.name == "mine"
        assert done.json["assumed"] == list(camera.marks.paths("assumed"))
        if "--frame" in options:
            assert camera.sensor.shape == (40, 52) and camera.marks["sensor.shape"] == "stated"
            continue
        planned = lfcal("plan", out, "--depths", "-10,10", "--resample").ok()
        assert "measure the array with lfcal camera check c.json WHITE" in planned.err
    (tmp_path / "lf.json").write_text(napari(objective_magnification=1e308))
    said = "magnification: expected a number > 0 and ≤ 1e+15"
    lfcal("camera", "import", tmp_path / "lf.json", "-o", tmp_path / "none.json").refused(said)
    assert not (tmp_path / "none.json").exists()


@needs_real
def test_a_sensor_that_cannot_be_the_maker_s_is_questioned(lfcal: Lfcal) -> None:
    done = lfcal("camera", "import", REAL, "--sensor", "2048x2048,5.5")
    assert done.code == 0 and "distortion (3187, 2651 px)" in done.err and "nothing written" in done.out


# -- new --------------------------------------------------------------------------------------------------
def test_new_without_questions(lfcal: Lfcal, tmp_path: Path) -> None:
    done = lfcal(
        *("camera", "new", "--type", "multifocus", "--yes", *SENSOR, "--pitch", "31.7px", "--wavelength", "532"),
        *("--array", "hexagonal", "--set", "sensor.full_well_e=9000", "--set", "optics.blade_rotation_rad=5deg"),
        *("--name", "R", "-o", tmp_path / "c.json", "--json"),
    )
    camera = read(tmp_path / "c.json")
    assert done.code == 0 and camera.name == "R" and camera.pitch_px == pytest.approx(31.7)
    assert camera.wavelength_um == 0.532 and camera.sensor.full_well_e == 9000
    assert camera.optics == MainLens(200e3, 4, 1e6, blade_rotation_rad=np.deg2rad(5))
    assert camera.marks["lattice.gap_um"] == "assumed" and camera.marks["sensor.full_well_e"] == "stated"
    again = lfcal("camera", "new", "--type", "focused", "--yes", "-o", tmp_path / "c.json")
    assert again.code == 2 and "--force" in again.err and read(tmp_path / "c.json") == camera
    lfcal("camera", "new", "--type", "focused", "--yes", "--force", "-o", tmp_path / "c.json").ok()


def test_a_preset_is_another_camera(lfcal: Lfcal, tmp_path: Path) -> None:
    options = ("--preset", "lfm_20x05", "--objective", "40,0.8,1", "--yes")
    lfcal("camera", "new", *options, "-o", tmp_path / "c.json").ok()
    camera = read(tmp_path / "c.json")
    assert camera.marks["optics.magnification"] == "stated" and camera.marks["lattice.pitch_um"] == "assumed"
    assert camera.magnification == 40 and camera.lattice.pitch_um == 125


def test_new_asks(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    answers = {
        "numerical aperture": ["0.8"],
        "magnification": ["40"],
        "pixel pitch": ["abc", "6.5"],
        "pitch of the micro-images": ["20px"],
        "gap": ["2.4mm"],
        "virtual depths": ["1x2", ""],
        "focal length of the tube": ["180"],
    }

    def prompt(text: str, default: object = None, show_default: bool = True) -> str:
        asked.append(text)
        found = next((left for word, left in answers.items() if text.startswith(word)), [])
        return found.pop(0) if found else str(default or "")

    monkeypatch.setattr(typer, "prompt", prompt)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    done = lfcal("camera", "new", "--type", "microscope", "--array", "square", "-o", tmp_path / "c.json")
    camera = read(tmp_path / "c.json")
    assert done.code == 0 and camera.magnification == 40 and camera.lattice.gap_um == 2400
    assert camera.sensor.pixel_um == 6.5 and "'abc'" in done.err and "'1x2'" in done.err
    assert camera.lattice.pitch_um == 130
    # an answer that is refused leaves what was there
    assert camera.lattice.types[0].focal_length_um == 2400
    assert camera.optics.tube_length_um == 180e3  # type: ignore[union-attr]
    assert not any("lenslet array" in text for text in asked)
    assert camera.marks["optics.numerical_aperture"] == "stated" and camera.marks["sensor.shape"] == "assumed"


def test_a_fourier_microscope_is_described_by_options_and_planned(lfcal: Lfcal, tmp_path: Path) -> None:
    out = tmp_path / "flfm.json"
    places = "lattice.lens_centres_um=-2mm,0; 2mm,0; 0,2.5mm"
    lfcal("camera", "new", "--type", "fourier", "--yes", "--objective", "20,0.5,1", "--set", places, "-o", out).ok()
    camera = Camera.from_json(out.read_text())
    assert isinstance(camera.lattice, PupilLenslets)
    assert camera.lattice.lens_centres_um == ((-2000.0, 0.0), (2000.0, 0.0), (0.0, 2500.0))
    planned = lfcal("plan", out, "--depths=-10,0,10", "--json", "-o", tmp_path / "plan.json").ok()
    facts = json.loads(planned.out)
    assert facts["period"] == [1, 1] and facts["virtual_depths"] == []
    lfcal("plan", out, "--virtual-depths", "3", "-o", tmp_path / "other.json").refused("virtual depth")
    refused = lfcal("camera", "new", "--type", "fourier", "--yes", "--pitch", "100", "-o", tmp_path / "no.json")
    refused.refused("an entry of a Fourier light-field microscope")


def test_mistakes_end_in_one_line(lfcal: Lfcal, tmp_path: Path) -> None:
    focused = "--yes --type focused"
    for words, said in (
        ("", "no terminal"),
        ("--yes", "--type"),
        ("--yes --type pinhole", "'pinhole'"),
        (f"{focused} --preset r29", "not both"),
        ("--yes --preset r30", "'r30'"),
        (f"{focused} --sensor 4384", "ROWSxCOLUMNS"),
        (f"{focused} --sensor 10x10,5kg", "length"),
        (f"{focused} --lens 200,,4", "FOCAL"),
        (f"{focused} --lens 1,2,3,4", "FOCAL"),
        (f"{focused} --pitch 20px", "--sensor"),
        (f"{focused} --set sensor.color=3", "sensor.color"),
        (f"{focused} --set sensor.bit_depth=12.5", "whole number"),
        (f"{focused} --objective 20", "main lens"),
        (f"{focused} --wavelength 0.55", "wavelength"),
        ("--yes --type multifocus --array square", "lens types"),
    ):
        done = lfcal("camera", "new", *words.split(), "-o", tmp_path / "c.json").refused(said)
        assert done.out == "" and not (tmp_path / "c.json").exists(), words


# -- show -------------------------------------------------------------------------------------------------
def test_show(lfcal: Lfcal, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    done = lfcal("camera", "show", tmp_path / "c.xml")
    for shown in ("pixel pitch", "assumed", "derived", "stated", "38.3738 px", "not applied", "from assumed values"):
        assert shown in done.out
    data = lfcal("camera", "show", "r29", "--json").json
    assert data["assumed"] == data["doubts"] == [] and Camera.from_dict(data["camera"]) == preset("r29")
    bench, bend = preset("bench"), LatticeDistortion("radial", (0.0, 0.0), 800.0, ((11.0,),))
    lattice = replace(bench.lattice, shear_rad=0.002, distortion=bend)
    sensor = replace(bench.sensor, saturation=4000.0, dsnu_e=1.25, linearity=0.01)
    paths = ("sensor.saturation", "sensor.dsnu_e", "sensor.linearity", "lattice.shear_rad", "lattice.distortion")
    marks = Marks.of(dict.fromkeys(paths, "measured"))
    (tmp_path / "c.json").write_text(replace(bench, lattice=lattice, sensor=sensor, marks=marks).to_json())
    lines = lfcal("camera", "show", tmp_path / "c.json").out.splitlines()
    for shown in ("4000 counts", "1.25 e-", "linearity", "0.114592 °", "radial of degree 3, up to 2.00 px"):
        assert ["measured" in line for line in lines if shown in line] == [True], shown


def test_a_camera_in_mm_is_doubted(lfcal: Lfcal, tmp_path: Path) -> None:
    data = preset("bench").to_dict()
    data["sensor"]["pixel_um"] = 0.0055
    (tmp_path / "c.json").write_text(json.dumps(data))
    for command in (("camera", "show"), ("plan", "--virtual-depths", "3", "--cutout", "31")):
        done = lfcal(*command, tmp_path / "c.json")
        assert "did you mean 5.5 µm (mm for µm)" in done.err
    del data["sensor"]["black_level"]
    (tmp_path / "c.json").write_text(json.dumps(data))
    lfcal("camera", "show", tmp_path / "c.json").refused("black_level", "c.json")


# -- check ------------------------------------------------------------------------------------------------
SHAPE = (230, 270)


def described(pitch: float = 16.0, rotation: float = 0.004, offset: tuple[float, float] = (-1.0, 1.5)) -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", pitch * 5, 400.0, types, rotation, offset)
    return Camera("c", MainLens(), lattice, Sensor(SHAPE, 5.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a white image, a dark frame, a camera that fits, and one of a fifth longer pitch."""
    root = tmp_path_factory.mktemp("check")
    tifffile.imwrite(
        root / "white.tif", draw_white(SHAPE, 16.0, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.004).frame
    )
    tifffile.imwrite(root / "dark.tif", np.full(SHAPE, 100, np.uint16))
    (root / "fitting.json").write_text(described().to_json())
    (root / "camera.json").write_text(described(20.0).to_json())
    return root


@pytest.fixture
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(folder)
    return folder


DARK = ("--dark", "dark.tif")


def check(lfcal: Lfcal, camera: Camera, tmp_path: Path, *options: object) -> Run:
    (tmp_path / "c.json").write_text(camera.to_json())
    return lfcal("camera", "check", tmp_path / "c.json", "white.tif", *DARK, "--workers", "2", *options)


@pytest.mark.usefixtures("here")
def test_a_camera_that_fits(lfcal: Lfcal, tmp_path: Path) -> None:
    done = lfcal("camera", "check", "fitting.json", "white.tif", *DARK, "--json").ok()
    lines = {line["label"]: line for line in done.json["lines"]}
    assert lines["pitch"]["verdict"] == lines["rotation"]["verdict"] == done.json["answer"] == "fits", done.out
    white = tifffile.imread("white.tif")
    tifffile.imwrite(tmp_path / "rgb.tif", np.stack([white // 3, white, white // 2], -1), photometric="rgb")
    lfcal("camera", "check", "fitting.json", tmp_path / "rgb.tif").refused("grey")
    lfcal("camera", "check", "fitting.json", tmp_path / "rgb.tif", "--channel", "G").ok()


@pytest.mark.usefixtures("here")
def test_a_camera_that_differs_is_measured(lfcal: Lfcal, tmp_path: Path) -> None:
    camera, out = described(pitch=16.1, rotation=0.0), tmp_path / "m.json"
    done = check(lfcal, camera, tmp_path)
    assert done.code == 1 and "differs" in done.out and "-o camera.json" in done.err
    check(lfcal, camera, tmp_path, "-o", out).ok()
    measured = read(out)
    assert measured.pitch_px == pytest.approx(16.0, abs=0.01)
    assert measured.marks["lattice.pitch_um"] == measured.marks["lattice.rotation_rad"] == "measured"
    assert measured.lattice.rotation_rad == pytest.approx(0.004, abs=2e-4)


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_a_measured_camera_fits_and_is_replaced_with_force_alone(lfcal: Lfcal, tmp_path: Path) -> None:
    camera, out = described(pitch=16.1, rotation=0.0), tmp_path / "m.json"
    check(lfcal, camera, tmp_path, "-o", out).ok()
    lfcal("camera", "check", out, "white.tif", *DARK).ok()
    check(lfcal, camera, tmp_path, "-o", out).refused("--force")
    check(lfcal, camera, tmp_path, "-o", out, "--force").ok()


@pytest.mark.usefixtures("here")
def test_what_was_assumed_cannot_be_wrong(lfcal: Lfcal, tmp_path: Path) -> None:
    marks = Marks.of(dict.fromkeys(("lattice.rotation_rad", "lattice.offset_um", "sensor.shape"), "assumed"))
    camera = replace(described(rotation=0.0, offset=(30.0, 0.0)), marks=marks, sensor=Sensor((100, 100), 5.0))
    assert "was assumed" in check(lfcal, camera, tmp_path, "-o", tmp_path / "m.json").ok().out
    assert read(tmp_path / "m.json").sensor.shape == SHAPE


@pytest.mark.usefixtures("here")
def test_another_camera_does_not_fit_and_is_not_written(lfcal: Lfcal, tmp_path: Path) -> None:
    square = replace(described(), lattice=LensletLattice("square", 80.0, 400.0))
    small = replace(described(), sensor=Sensor((100, 100), 5.0))
    for camera in (small, square):
        done = check(lfcal, camera, tmp_path)
        assert done.code == 1 and "does not fit" in done.out
    for more in ((), ("--anyway",)):
        check(lfcal, small, tmp_path, "-o", tmp_path / "m.json", *more).refused("sensor of the white image")
        assert not (tmp_path / "m.json").exists()


@pytest.mark.usefixtures("here")
def test_inputs_are_never_outputs(lfcal: Lfcal) -> None:
    words = ("-o", "fitting.json", "--force")
    lfcal("camera", "check", "fitting.json", "white.tif", *words).refused("a file other than the input")
    lfcal("camera", "import", "fitting.json", *words).refused("a file other than the input")


# -- ``lfcal camera check``: what does not fit the white image is written on demand alone --


@pytest.mark.usefixtures("here")
def test_a_camera_that_does_not_fit_is_written_on_request_alone(lfcal: Lfcal, tmp_path: Path) -> None:
    out = tmp_path / "measured.json"
    words = ("camera", "check", "camera.json", "white.tif", *DARK, "--workers", "2", "-o", out)
    done = lfcal(*words)
    assert done.code == 1 and "does not fit" in done.out and not out.exists()
    assert "nothing written: camera and white image do not match" in done.err and "--anyway" in done.err


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_a_camera_that_does_not_fit_is_written_anyway(lfcal: Lfcal, tmp_path: Path) -> None:
    out = tmp_path / "measured.json"
    words = ("camera", "check", "camera.json", "white.tif", *DARK, "--workers", "2", "-o", out)
    done = lfcal(*words, "--json")
    assert done.code == 1 and done.json["written"] is None and not out.exists()
    assert "do not match" not in lfcal(*words, "--anyway").ok().err
    assert read(out).pitch_px == pytest.approx(16.0, abs=0.01) and read(out).marks["lattice.pitch_um"] == "measured"


@pytest.mark.usefixtures("here")
def test_a_mirrored_white_image_is_named_and_no_camera_written(lfcal: Lfcal, tmp_path: Path) -> None:
    mirrored, out = tmp_path / "mirrored.tif", tmp_path / "measured.json"
    tifffile.imwrite(mirrored, tifffile.imread("white.tif")[:, ::-1].copy())
    words = ("camera", "check", "fitting.json", mirrored, *DARK, "--workers", "2", "-o", out)
    done = lfcal(*words)
    assert done.code == 1 and not out.exists()
    assert "the frames are mirrored left to right" in done.err and "σ" in done.err
    assert "--orientation mirror-x, here, in lfcal plan and in lfcal assemble" in done.err


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_a_mirrored_white_image_is_turned_on_request(lfcal: Lfcal, tmp_path: Path) -> None:
    mirrored, out, upright = (tmp_path / name for name in ("mirrored.tif", "measured.json", "upright.json"))
    tifffile.imwrite(mirrored, tifffile.imread("white.tif")[:, ::-1].copy())
    words = ("camera", "check", "fitting.json", mirrored, *DARK, "--workers", "2", "-o", out)
    assert lfcal(*words, "--json").json["turned"] == ["mirror-x"]
    assert "mirrored" not in lfcal(*words, "--orientation", "mirror-x").ok().err
    lfcal("camera", "check", "fitting.json", "white.tif", *DARK, "-o", upright).ok()
    ours, theirs = (read(path).lattice for path in (out, upright))
    assert ours.rotation_rad == pytest.approx(theirs.rotation_rad, abs=1e-5) and ours.type_step == theirs.type_step
    assert ours.offset_um == pytest.approx(theirs.offset_um, abs=0.05)


@pytest.mark.usefixtures("here")
def test_a_folder_of_dark_frames_has_images(lfcal: Lfcal, tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    none = lfcal("camera", "check", "fitting.json", "white.tif", "--dark", tmp_path / "none")
    none.refused("expected at least one image")


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_dark_and_white_frames_may_be_folders(lfcal: Lfcal, tmp_path: Path) -> None:
    """As `lfcal assemble` takes them: the means of all frames in the folder."""
    for name in ("white", "dark"):
        (tmp_path / name).mkdir()
        for k, change in enumerate((0, 6)):
            tifffile.imwrite(tmp_path / name / f"{k}.tif", tifffile.imread(f"{name}.tif") + np.uint16(change))
    single, several = tmp_path / "a.json", tmp_path / "b.json"
    folders = (tmp_path / "white", "--dark", tmp_path / "dark")
    lfcal("camera", "check", "fitting.json", "white.tif", *DARK, "-o", single).ok()
    lfcal("camera", "check", "fitting.json", *folders, "-o", several).ok()
    assert read(several).lattice == read(single).lattice
    lfcal("white", *folders, "-o", tmp_path / "out").ok()


@pytest.mark.usefixtures("here")
def test_a_white_image_of_a_part_of_the_sensor(lfcal: Lfcal, tmp_path: Path) -> None:
    part, out = tmp_path / "part.tif", tmp_path / "m.json"
    tifffile.imwrite(part, tifffile.imread("white.tif")[17:, 40:230])
    words = ("camera", "check", "fitting.json", part, "-o", out)
    lfcal(*words).refused("sensor of the white image", "--origin ROW,COLUMN")
    lfcal(*words, "--origin", "18,40").refused(
        "an image within the sensor of 230 x 270 px, got 213 x 190 px at the origin 18,40"
    )
    lfcal(*words, "--origin", "17,40").ok()
    assert read(out).sensor.shape == SHAPE
    turned = lfcal(*words, "--origin", "17,40", "--orientation", "mirror-x", "--force")
    turned.refused("as-is with --origin")


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_masked_pixels_of_a_part_of_the_sensor(lfcal: Lfcal, tmp_path: Path) -> None:
    """The list counts rows and columns on the sensor, the frame starts at --origin."""
    white = tifffile.imread("white.tif").astype(np.float32)[10:, 20:]
    tifffile.imwrite(tmp_path / "whole.tif", white)
    white[90, 80], white[91, 80] = np.nan, 60000
    tifffile.imwrite(tmp_path / "bad.tif", white)
    (tmp_path / "mask.csv").write_text("row,column\n101,100\n")
    found = []
    for name, more in (("whole", ()), ("bad", ("--mask", tmp_path / "mask.csv"))):
        done = lfcal("camera", "check", "camera.json", tmp_path / f"{name}.tif", "--origin", "10,20", *more, "--json")
        assert done.code == 1 and ("without a finite value): 2" in done.err) == bool(more), done.err
        found.append(done.json["camera"]["lattice"]["pitch_um"])
    assert found[0] == pytest.approx(found[1], abs=5e-3)


# -- ``lfcal camera sensor``: from folders of flats and darks to a camera with its measured sensor --
TRUTH = Truth(shape=(120, 160), dark_e_s=30.0)
EXPOSURES = (0.01, 0.03, 0.1, 0.2, 0.3)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """White images through lenslets and darks, two a level, exposures in their names or in those of their folders."""
    place = tmp_path_factory.mktemp("sensor")
    for name in ("flats", "darks/10ms", "darks/2s"):
        (place / name).mkdir(parents=True)
    for k, seconds in enumerate(EXPOSURES):
        light = seconds / 0.3 * 1.2 * TRUTH.full_e * micro_images(TRUTH.shape)
        for n in range(2):
            frame = TRUTH.frame(light, seconds, key=10 * k + n)
            tifffile.imwrite(place / "flats" / f"flat_{1000 * seconds:g}ms_{n}.tif", frame)
    for folder, seconds in (("10ms", 0.01), ("2s", 2.0)):
        for n in range(3):
            frame = TRUTH.frame(0.0, seconds, key=900 + int(seconds) * 10 + n)
            tifffile.imwrite(place / "darks" / folder / f"{n}.tif", frame)
    return place


def test_folders_become_a_camera_and_a_picture(lfcal: Lfcal, folders: Path, tmp_path: Path) -> None:
    out, picture = tmp_path / "camera.json", tmp_path / "ptc.png"
    words = ("camera", "sensor", folders / "flats", folders / "darks", "--camera", "bench", "-o", out)
    shown = lfcal(*words, "--figure", picture, "--workers", 2).ok().out
    assert "e⁻ per count" in shown and str(out) in shown and picture.read_bytes().startswith(b"\x89PNG")
    camera = read(out)
    assert camera.sensor.electrons_per_count == pytest.approx(5.0, rel=0.02)
    assert camera.sensor.read_noise_e == pytest.approx(8.0, rel=0.03)
    assert camera.sensor.dark_current_e_s == pytest.approx(30.0, rel=0.05)
    assert camera.sensor.linearity == pytest.approx(0, abs=0.002)
    assert camera.marks["sensor.full_well_e"] == camera.marks["sensor.linearity"] == "measured"
    assert camera.lattice == preset("bench").lattice and camera.marks["sensor.prnu"] == "stated"
    lfcal(*words).refused("--force")
    found = lfcal(*words[:4], "--json").ok().json
    assert found["gain"]["value"] == pytest.approx(0.2, abs=5 * found["gain"]["sigma"])
    assert found["prnu"] is None and any("structure" in note for note in found["notes"])
    assert len(found["curve"]["signal"]) == len(found["curve"]["variance"]) > 20
    assert found["frames"] == {"flats": 10, "darks": 6}


def test_stacks_and_folders_of_folders_are_the_same_frames(lfcal: Lfcal, folders: Path, tmp_path: Path) -> None:
    """Levels by folder, by page of a file without exposures, or by name: the same gain."""
    pages = []
    for k, seconds in enumerate(EXPOSURES):
        (tmp_path / "levels" / f"level{k}").mkdir(parents=True)
        for n in range(2):
            frame = tifffile.imread(folders / "flats" / f"flat_{1000 * seconds:g}ms_{n}.tif")
            tifffile.imwrite(tmp_path / "levels" / f"level{k}" / f"{n}.tif", frame)
            pages.append(frame)
    np.save(tmp_path / "flats.npy", np.stack(pages))
    by_name, by_folder, by_page = (
        lfcal("camera", "sensor", flats, folders / "darks", "--json").ok().json
        for flats in (folders / "flats", tmp_path / "levels", tmp_path / "flats.npy")
    )
    assert by_name["gain"] == by_folder["gain"] == by_page["gain"]
    assert by_name["linearity"] is not None and by_folder["linearity"] is by_page["linearity"] is None


def test_doubtful_figures_and_mistakes_leave_no_camera(lfcal: Lfcal, folders: Path, tmp_path: Path) -> None:
    flats, darks, out = folders / "flats", folders / "darks", tmp_path / "c.json"
    for kind in ("flats", "darks"):
        (tmp_path / kind).mkdir()
        for file in sorted((folders / kind).rglob("*.tif")):
            values = np.clip((tifffile.imread(file).astype(float) - 40) / 4055, 0, 1)
            name = f"{file.parent.name}_{file.name}" if kind == "darks" else file.name
            tifffile.imwrite(tmp_path / kind / name, np.rint(255 * values ** (1 / 2.2)).astype(np.uint8))
    for words, said in (
        ((tmp_path / "flats", tmp_path / "darks", "--camera", "bench", "-o", out), "record raw"),
        ((flats, flats), "no file that is in both"),
        ((darks, flats), "exchange flats and darks"),
        ((flats, darks, "-o", out), "--camera"),
        ((flats, darks, "--figure", tmp_path / "ptc.xyz"), ".png"),
        ((flats, darks, "--cfa", "RGX"), "letters"),
    ):
        assert said in lfcal("camera", "sensor", *words).refused().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["darks", "flats"]


# -- Assumed values are listed at the import; later commands name those on which their results depend --
LIGHT = ("sensor.read_noise_e", "sensor.full_well_e", "wavelength_um")


def camera_file(folder: Path, *paths: str) -> Path:
    path = folder / "camera.json"
    path.write_text(replace(preset("bench"), marks=Marks.of(dict.fromkeys(paths, "assumed"))).to_json())
    return path


def commands(folder: Path, camera: Path) -> tuple[tuple[object, ...], ...]:
    """Return commands whose results do not depend on light and noise."""
    plan, image = folder / "plan.json", folder / "white.tif"
    tifffile.imwrite(image, np.zeros(preset("bench").sensor.shape, np.uint16))
    return (
        ("plan", camera, "--virtual-depths", 3, "-o", plan),
        ("acquire", plan, "--out", folder / "session", "--dry-run"),
        ("camera", "check", camera, image),
        ("white", image, "--camera", camera, "-o", folder / "out"),
        ("views", image, "--camera", camera, "-o", folder / "views"),
    )


def test_only_values_that_a_result_needs_are_repeated(lfcal: Lfcal, tmp_path: Path) -> None:
    shown = lfcal("camera", "show", camera_file(tmp_path, *LIGHT)).ok()
    assert "3 values of light and noise" in shown.out + shown.err
    simulated = lfcal("simulate", tmp_path / "camera.json", "--virtual-depths", 3, "--plan-only")
    assert "3 values of light and noise" in simulated.err
    for words in commands(tmp_path, tmp_path / "camera.json"):
        assert "assumed" not in lfcal(*words).err, words
    for path in (tmp_path / "plan.json", tmp_path / "out", tmp_path / "views"):
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
    for words in commands(tmp_path, camera_file(tmp_path, "lattice.gap_um", *LIGHT)):
        said = lfcal(*words).err
        assert said.count("gap between lenslets and sensor") == 1 and "light and noise" not in said, words


def test_centres_of_lenslets_repeat_the_values_they_depend_on(lfcal: Lfcal, tmp_path: Path) -> None:
    camera, image = preset("flfm_20x05"), tmp_path / "white.tif"
    path = tmp_path / "camera.json"
    marks = Marks.of({one.path: "assumed" for one in quantities_of(camera)})
    path.write_text(replace(camera, marks=marks).to_json())
    tifffile.imwrite(image, np.zeros(camera.sensor.shape, np.uint16))
    said = lfcal("white", image, "--camera", path).err
    for label in ("optical axis on the sensor", "pixel pitch"):
        assert said.count(label) == 1
    for label in ("magnification", "focal length", "gap", "centres of the lenslets", "light and noise"):
        assert label not in said
    # the comparison with a lattice is not for this camera: what is advised can be done
    assert "camera check" not in said
    lfcal("camera", "check", path, image).refused(f"lfcal white {image.name} --camera {path.name}")
    assert f"lfcal white WHITE --camera {path.name}" in lfcal("plan", path, "--depths", 0).err


def test_values_of_the_sensor_are_named_alone_if_only_the_noise_counts(lfcal: Lfcal, tmp_path: Path) -> None:
    camera = camera_file(tmp_path, "lattice.gap_um", "optics.f_number", "sensor.prnu", *LIGHT)
    frame, matrix = tmp_path / "frame.tif", tmp_path / "H.npy"
    tifffile.imwrite(frame, np.full((1000, 1000), 100, np.uint16))
    np.save(matrix, np.random.default_rng(0).uniform(size=(1, 3, 3, 9, 9)))
    out = ("-o", tmp_path / "out.tif", "--force")
    commands: tuple[tuple[tuple[object, ...], int], ...] = (
        (("merits", "Bayer", "--camera", camera), 2),
        (("merits", "Bayer", "--camera", camera, "--uncorrected"), 3),
        (("compare", "Bayer", "CYMG", "--camera", camera, "-o", tmp_path / "gain.png", "--force"), 2),
        (("coding", matrix, "--points", 2, "--sensor", camera), 2),
        (("recover", frame, "--modulator", "nd:1,0.25/0.25,0.0625", "--camera", camera, *out), 2),
        (("views", frame, "--camera", "bench", "--sensor", camera, "--modulator", "Bayer", *out), 2),
    )
    for words, count in commands:
        done = lfcal("multiplex", *words)
        assert f"assumed: {count} values of light and noise" in done.err, (words, done.err)
        assert "gap" not in done.err and "f-number" not in done.err
    (tmp_path / "flats").mkdir()
    said = lfcal("camera", "sensor", tmp_path / "flats", tmp_path / "flats", "--camera", camera).err
    assert "assumed" not in said, "the command measures these values"
