"""``lfcal camera`` as a newcomer uses it: what is known, what is assumed, and what the white image says."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
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
)
from tests.camera.importers.files import CONFIGURATION, OLAF, napari
from tests.camera.importers.test_raytrix_xml import REAL, needs_real, xml
from tests.cli.conftest import Run
from tests.lattice.white_frames import draw_white

Command = Callable[..., Run]
SENSOR = ("--sensor", "4384x6576,5.5", "--lens", "200,4,1000")


def read(path: Path) -> Camera:
    return Camera.from_json(path.read_text(encoding="utf-8"))


# -- import -----------------------------------------------------------------------------------------------
def test_import_states_what_the_options_state(lfcal: Command, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    done = lfcal("camera", "import", tmp_path / "c.xml", *SENSOR, "--gap", "900", "-o", tmp_path / "camera.json")
    assert done.code == 0 and "written:" in done.out
    camera = read(tmp_path / "camera.json")
    for path in ("sensor.shape", "sensor.pixel_um", "optics.focal_length_um", "lattice.gap_um"):
        assert camera.marks[path] == "stated"
    assert camera.lattice.gap_um == 900 and camera.pitch_px == pytest.approx(38.3737792969)
    assert camera.marks["sensor.read_noise_e"] == "assumed"
    assert "14 values of light and noise" in done.err and "not applied" in done.err


def test_every_command_says_what_is_assumed(lfcal: Command, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    done = lfcal("plan", tmp_path / "c.xml", "--virtual-depths", "3")
    note = done.err.splitlines()[0]
    for said in (
        "assumed",
        "pixel pitch 5.5 µm",
        "focal length of the main lens 200 mm",
        "--sensor ROWSxCOLUMNS,PIXEL",
    ):
        assert said in note

    def row(label: str) -> str:
        return next(line for line in done.out.splitlines() if line.strip().startswith(label))

    assert "(from assumed values)" in row("lateral step") and "(from assumed values)" in row("object-space depth")
    assert "assumed" not in row("cell of the lenslet array") and "assumed" not in row("virtual depth")
    options = (*SENSOR, "--gap", "900", "--focus", "2,3,5", "-o", tmp_path / "k.json")
    lfcal("camera", "import", tmp_path / "c.xml", *options)
    sure = lfcal("plan", tmp_path / "k.json", "--virtual-depths", "3")
    assert "(from assumed" not in sure.out and not sure.err, "a plan depends on no value of light and noise"


def test_looking_ahead_lists_what_is_assumed(lfcal: Command, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    plan = tmp_path / "plan.json"
    assert lfcal("plan", tmp_path / "c.xml", "--virtual-depths", "3", "-o", plan).code == 0
    for words in (
        ("simulate", plan, "--plan-only"),
        ("acquire", plan, "--out", tmp_path / "session", "--dry-run", "--no-check-stage"),
    ):
        done = lfcal(*words, "--json")
        assert done.code == 0, done.err
        assert {"lattice.gap_um", "sensor.pixel_um"} <= set(done.json["assumed"])  # type: ignore[index, call-overload]


@pytest.mark.parametrize(
    ("name", "text", "options", "pitch"),
    [
        ("o.yaml", OLAF, (), 112 / 6.5),
        ("metadata.txt", napari(), (), 125 / 7.4),
        ("mm.cfg", CONFIGURATION, ("--resolution", "Res40x", "--pitch", "20px", "--sensor", "1400x1500,6.5"), 20.0),
    ],
)
def test_files_of_other_programs(
    lfcal: Command, tmp_path: Path, name: str, text: str, options: tuple[str, ...], pitch: float
) -> None:
    (tmp_path / name).write_text(text)
    done = lfcal("camera", "import", tmp_path / name, *options, "--name", "mine", "--json", "-o", tmp_path / "c.json")
    camera = read(tmp_path / "c.json")
    assert done.code == 0 and camera.pitch_px == pytest.approx(pitch) and camera.name == "mine"
    assert done.json["assumed"] == list(camera.marks.paths("assumed"))  # type: ignore[index]
    planned = lfcal("plan", tmp_path / "c.json", "--depths", "-10,10", "--resample")
    assert planned.code == 0 and "measure the array with lfcal camera check c.json WHITE" in planned.err


def test_a_camera_with_which_nothing_can_be_calculated_is_not_written(lfcal: Command, tmp_path: Path) -> None:
    (tmp_path / "lf.json").write_text(napari(objective_magnification=1e308))
    done = lfcal("camera", "import", tmp_path / "lf.json", "-o", tmp_path / "camera.json")
    assert done.code == 2 and "magnification: expected a number > 0 and ≤ 1e+15" in done.err
    assert not (tmp_path / "camera.json").exists()


def test_the_size_of_the_sensor_comes_from_a_frame(lfcal: Command, tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text(napari())
    tifffile.imwrite(tmp_path / "f.tif", np.zeros((40, 52), np.uint16))
    done = lfcal("camera", "import", tmp_path / "m.json", "--frame", tmp_path / "f.tif", "-o", tmp_path / "c.json")
    assert done.code == 0 and read(tmp_path / "c.json").sensor.shape == (40, 52)
    assert read(tmp_path / "c.json").marks["sensor.shape"] == "stated"


@needs_real
def test_a_sensor_that_cannot_be_the_maker_s_is_questioned(lfcal: Command) -> None:
    done = lfcal("camera", "import", REAL, "--sensor", "2048x2048,5.5")
    assert done.code == 0 and "distortion (3187, 2651 px)" in done.err and "nothing written" in done.out


# -- new --------------------------------------------------------------------------------------------------
def test_new_without_questions(lfcal: Command, tmp_path: Path) -> None:
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
    assert lfcal("camera", "new", "--type", "focused", "--yes", "--force", "-o", tmp_path / "c.json").code == 0


def test_a_preset_is_somebody_else_s_camera(lfcal: Command, tmp_path: Path) -> None:
    options = ("--preset", "lfm_20x05", "--objective", "40,0.8,1", "--yes")
    assert lfcal("camera", "new", *options, "-o", tmp_path / "c.json").code == 0
    camera = read(tmp_path / "c.json")
    assert camera.marks["optics.magnification"] == "stated" and camera.marks["lattice.pitch_um"] == "assumed"
    assert camera.magnification == 40 and camera.lattice.pitch_um == 125


def test_new_asks(lfcal: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_fourier_microscope_is_described_by_options_and_planned(lfcal: Command, tmp_path: Path) -> None:
    out = tmp_path / "flfm.json"
    places = "lattice.lens_centres_um=-2mm,0; 2mm,0; 0,2.5mm"
    done = lfcal("camera", "new", "--type", "fourier", "--yes", "--objective", "20,0.5,1", "--set", places, "-o", out)
    assert done.code == 0, done.err
    camera = Camera.from_json(out.read_text())
    assert isinstance(camera.lattice, PupilLenslets)
    assert camera.lattice.lens_centres_um == ((-2000.0, 0.0), (2000.0, 0.0), (0.0, 2500.0))
    planned = lfcal("plan", out, "--depths=-10,0,10", "--json", "-o", tmp_path / "plan.json")
    assert planned.code == 0, planned.err
    facts = json.loads(planned.out)
    assert facts["period"] == [1, 1] and facts["virtual_depths"] == []
    refused = lfcal("plan", out, "--virtual-depths", "3", "-o", tmp_path / "other.json")
    assert refused.code == 2 and "virtual depth" in refused.err
    wrong = lfcal("camera", "new", "--type", "fourier", "--yes", "--pitch", "100", "-o", tmp_path / "no.json")
    assert wrong.code == 2 and "an entry of a Fourier light-field microscope" in wrong.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("new",), "no terminal"),
        (("new", "--yes"), "--type"),
        (("new", "--yes", "--type", "pinhole"), "'pinhole'"),
        (("new", "--yes", "--type", "focused", "--preset", "r29"), "not both"),
        (("new", "--yes", "--preset", "r30"), "'r30'"),
        (("new", "--yes", "--type", "focused", "--sensor", "4384"), "ROWSxCOLUMNS"),
        (("new", "--yes", "--type", "focused", "--sensor", "10x10,5kg"), "length"),
        (("new", "--yes", "--type", "focused", "--lens", "200,,4"), "FOCAL"),
        (("new", "--yes", "--type", "focused", "--lens", "1,2,3,4"), "FOCAL"),
        (("new", "--yes", "--type", "focused", "--pitch", "20px"), "--sensor"),
        (("new", "--yes", "--type", "focused", "--set", "sensor.color=3"), "sensor.color"),
        (("new", "--yes", "--type", "focused", "--set", "sensor.bit_depth=12.5"), "whole number"),
        (("new", "--yes", "--type", "focused", "--objective", "20"), "main lens"),
        (("new", "--yes", "--type", "focused", "--wavelength", "0.55"), "wavelength"),
        (("new", "--yes", "--type", "multifocus", "--array", "square"), "lens types"),
    ],
)
def test_mistakes_end_in_one_line(lfcal: Command, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    done = lfcal("camera", *arguments, "-o", tmp_path / "c.json")
    assert done.code == 2 and done.out == "" and said in done.err
    assert len(done.err.strip().splitlines()) == 1 and not (tmp_path / "c.json").exists()


# -- show -------------------------------------------------------------------------------------------------
def test_show(lfcal: Command, tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    done = lfcal("camera", "show", tmp_path / "c.xml")
    for shown in ("pixel pitch", "assumed", "derived", "stated", "38.3738 px", "not applied", "from assumed values"):
        assert shown in done.out
    data = lfcal("camera", "show", "r29", "--json").json
    assert data["assumed"] == [] and data["doubts"] == []  # type: ignore[index]
    assert Camera.from_dict(data["camera"]) == preset("r29")  # type: ignore[index]


def test_show_what_was_measured(lfcal: Command, tmp_path: Path) -> None:
    bench = preset("bench")
    bend = LatticeDistortion("radial", (0.0, 0.0), 800.0, ((11.0,),))
    lattice = replace(bench.lattice, shear_rad=0.002, distortion=bend)
    sensor = replace(bench.sensor, saturation=4000.0, dsnu_e=1.25, linearity=0.01)
    paths = ("sensor.saturation", "sensor.dsnu_e", "sensor.linearity", "lattice.shear_rad", "lattice.distortion")
    marks = Marks.of(dict.fromkeys(paths, "measured"))
    (tmp_path / "c.json").write_text(replace(bench, lattice=lattice, sensor=sensor, marks=marks).to_json())
    lines = lfcal("camera", "show", tmp_path / "c.json").out.splitlines()
    for shown in ("4000 counts", "1.25 e-", "linearity", "0.114592 °", "radial of degree 3, up to 2.00 px"):
        (line,) = [line for line in lines if shown in line]
        assert "measured" in line


def test_a_camera_typed_in_mm_is_questioned(lfcal: Command, tmp_path: Path) -> None:
    data = preset("bench").to_dict()
    data["sensor"]["pixel_um"] = 0.0055
    (tmp_path / "c.json").write_text(json.dumps(data))
    for command in (("camera", "show"), ("plan", "--virtual-depths", "3", "--cutout", "31")):
        done = lfcal(*command, tmp_path / "c.json")
        assert "did you mean 5.5 µm (mm for µm)" in done.err
    del data["sensor"]["black_level"]
    (tmp_path / "c.json").write_text(json.dumps(data))
    done = lfcal("camera", "show", tmp_path / "c.json")
    assert done.code == 2 and "black_level" in done.err and "c.json" in done.err


# -- check ------------------------------------------------------------------------------------------------
SHAPE = (230, 270)


@pytest.fixture(scope="module")
def white(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("white")
    truth = draw_white(SHAPE, pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.004)
    tifffile.imwrite(folder / "white.tif", truth.frame)
    tifffile.imwrite(folder / "dark.tif", np.full(SHAPE, 100, np.uint16))
    return folder


def described(pitch: float = 16.0, rotation: float = 0.004, offset: tuple[float, float] = (-1.0, 1.5)) -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", pitch * 5, 400.0, types, rotation, offset)
    return Camera("c", MainLens(), lattice, Sensor(SHAPE, 5.0))


def check(lfcal: Command, folder: Path, tmp_path: Path, camera: Camera, *options: object) -> Run:
    (tmp_path / "c.json").write_text(camera.to_json())
    return lfcal(
        "camera",
        "check",
        tmp_path / "c.json",
        folder / "white.tif",
        "--dark",
        folder / "dark.tif",
        "--workers",
        "2",
        *options,
    )


def test_a_camera_that_fits(lfcal: Command, white: Path, tmp_path: Path) -> None:
    done = check(lfcal, white, tmp_path, described(), "--json")
    lines = {line["label"]: line for line in done.json["lines"]}  # type: ignore[index]
    assert lines["pitch"]["verdict"] == lines["rotation"]["verdict"] == "fits"
    assert done.code == 0 and done.json["answer"] == "fits", done.out  # type: ignore[index]


def test_a_camera_that_differs_is_measured(lfcal: Command, white: Path, tmp_path: Path) -> None:
    camera = described(pitch=16.1, rotation=0.0)
    done = check(lfcal, white, tmp_path, camera)
    assert done.code == 1 and "differs" in done.out and "-o camera.json" in done.err
    done = check(lfcal, white, tmp_path, camera, "-o", tmp_path / "m.json")
    measured = read(tmp_path / "m.json")
    assert done.code == 0 and measured.pitch_px == pytest.approx(16.0, abs=0.01)
    assert measured.marks["lattice.pitch_um"] == measured.marks["lattice.rotation_rad"] == "measured"
    assert measured.lattice.rotation_rad == pytest.approx(0.004, abs=2e-4)
    again = lfcal("camera", "check", tmp_path / "m.json", white / "white.tif", "--dark", white / "dark.tif")
    assert again.code == 0
    assert check(lfcal, white, tmp_path, camera, "-o", tmp_path / "m.json").code == 2
    assert check(lfcal, white, tmp_path, camera, "-o", tmp_path / "m.json", "--force").code == 0


def test_a_component_of_a_colour_image(lfcal: Command, white: Path, tmp_path: Path) -> None:
    frame = tifffile.imread(white / "white.tif")
    tifffile.imwrite(tmp_path / "rgb.tif", np.stack([frame // 3, frame, frame // 2], -1), photometric="rgb")
    (tmp_path / "c.json").write_text(described().to_json())
    refused = lfcal("camera", "check", tmp_path / "c.json", tmp_path / "rgb.tif")
    assert refused.code == 2 and "grey" in refused.err
    assert lfcal("camera", "check", tmp_path / "c.json", tmp_path / "rgb.tif", "--channel", "G").code == 0


def test_what_was_assumed_cannot_be_wrong(lfcal: Command, white: Path, tmp_path: Path) -> None:
    marks = Marks.of(dict.fromkeys(("lattice.rotation_rad", "lattice.offset_um", "sensor.shape"), "assumed"))
    camera = replace(described(rotation=0.0, offset=(30.0, 0.0)), marks=marks, sensor=Sensor((100, 100), 5.0))
    done = check(lfcal, white, tmp_path, camera, "-o", tmp_path / "m.json")
    assert done.code == 0 and "was assumed" in done.out and read(tmp_path / "m.json").sensor.shape == SHAPE


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "camera",
    [
        replace(described(), sensor=Sensor((100, 100), 5.0)),
        replace(described(), lattice=LensletLattice("square", 80.0, 400.0)),
        described(pitch=20.0),
    ],
)
def test_another_camera_does_not_fit(lfcal: Command, white: Path, tmp_path: Path, camera: Camera) -> None:
    done = check(lfcal, white, tmp_path, camera)
    assert done.code == 1 and "does not fit" in done.out


def test_another_camera_is_not_written(lfcal: Command, white: Path, tmp_path: Path) -> None:
    camera = replace(described(), sensor=Sensor((100, 100), 5.0))
    done = check(lfcal, white, tmp_path, camera, "-o", tmp_path / "m.json")
    assert done.code == 2 and not (tmp_path / "m.json").exists()


def test_inputs_are_never_outputs(lfcal: Command, white: Path, tmp_path: Path) -> None:
    shutil.copy(white / "white.tif", tmp_path / "w.tif")
    (tmp_path / "c.json").write_text(described().to_json())
    done = lfcal("camera", "check", tmp_path / "c.json", tmp_path / "w.tif", "-o", tmp_path / "c.json", "--force")
    assert done.code == 2 and "a file other than the input" in done.err
    done = lfcal("camera", "import", tmp_path / "c.json", "-o", tmp_path / "c.json", "--force")
    assert done.code == 2
