"""``lfcal white``: the lattice of a white image, its files, and cameras that it measures."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError
from lfcal.camera import Camera, LatticeDistortion, LensletLattice, LensType, MainLens, Sensor
from lfcal.lattice import LatticeFit, fit_lattice, load_lattice, save_lattice
from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Lfcal
from tests.lattice.white_frames import barrel, draw_white


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write white, dark and camera files of a three-type camera, and the white image in colour and as a mosaic."""
    folder = tmp_path_factory.mktemp("white")
    truth = draw_white((330, 400), pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, step=2)
    tifffile.imwrite(folder / "white.tif", truth.frame)
    tifffile.imwrite(folder / "dark.tif", np.full(truth.frame.shape, 100, np.uint16))
    tifffile.imwrite(folder / "rgb.tif", np.stack([truth.frame // 4, truth.frame, truth.frame // 2], -1))
    mosaic = truth.frame.astype(float) - 100
    mosaic[0::2, 0::2] *= 0.5
    mosaic[1::2, 1::2] *= 0.35
    np.save(folder / "mosaic.npy", mosaic)
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    camera = Camera("c", MainLens(), LensletLattice("hexagonal", 82.0, 400.0, types), Sensor(truth.frame.shape, 5.0))
    (folder / "camera.json").write_text(camera.to_json())
    return folder


@pytest.fixture
def here(files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(files)
    return files


def test_the_fit_is_shown_and_becomes_that_of_the_camera(lfcal: Lfcal, here: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = lfcal("white", "white.tif", "--dark", "dark.tif", "--camera", "camera.json", "-o", out).ok()
    for shown in ("hexagonal", "±", "px", "affine", "lens types", "standard errors"):
        assert shown in run.out
    measured = Camera.from_json((out / "camera.json").read_text())
    assert not run.err and measured.pitch_px == pytest.approx(16.0, abs=0.005) and measured.lattice.type_step == 2
    assert {path.name for path in out.iterdir()} == {"camera.json", "lattice.json", "residuals.csv", "residuals.png"}
    data = lfcal("white", "white.tif", "-o", tmp_path / "plain", "--json").ok().json
    assert data["pitch_px"] == pytest.approx(16.0, abs=0.005) and data["lens_types"] is None
    assert len(data["dead"]) == pytest.approx(0.05 * data["lenslets"], rel=0.5)
    assert {path.name for path in (tmp_path / "plain").iterdir()} == {Path(path).name for path in data["written"]}


@pytest.mark.usefixtures("here")
def test_lens_types_are_an_option(lfcal: Lfcal) -> None:
    words = ("white", "white.tif", "--camera", "camera.json", "--json")
    asked, not_asked = (lfcal(*words, option).ok().json for option in ("--types", "--no-types"))
    assert asked["lens_types"]["type_step"] == 2 and asked["camera"]["lattice"]["type_step"] == 2
    assert not_asked["lens_types"] is None and not_asked["camera"]["lattice"]["type_step"] == 1
    assert asked["pitch_px"] == not_asked["pitch_px"]


@pytest.mark.usefixtures("here")
def test_bad_input_is_one_line_and_leaves_nothing(lfcal: Lfcal, tmp_path: Path) -> None:
    for words in (
        "absent.tif",
        "dark.tif",
        "camera.json",
        "white.tif --kind round",
        "white.tif --pitch 20",
        "white.tif --camera r29 --no-types",
        "white.tif --camera lfm_20x05",
        "rgb.tif --channel each",
        "mosaic.npy --channel G",
        "mosaic.npy --cfa RGX",
    ):
        run = lfcal("white", *words.split(), "-o", tmp_path / "out").refused()
        assert run.out == "" and run.err.startswith("lfcal: ") and not (tmp_path / "out").exists(), words


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_one_colour_and_a_mosaic_have_the_lattice_of_the_grey_image(lfcal: Lfcal) -> None:
    refused = lfcal("white", "rgb.tif").refused("--channel G")
    assert "each" not in refused.err and "colour=" not in refused.err
    nominal = "white.tif --pitch 15 --kind hexagonal"
    for given in ("rgb.tif --channel G", "mosaic.npy", "mosaic.npy --cfa RGGB", nominal):
        run = lfcal("white", *given.split(), "--json").ok()
        assert not run.err and run.json["pitch_px"] == pytest.approx(16.0, abs=0.003)
        assert run.json["kind"] == "hexagonal"


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_each_colour_of_a_mosaic_has_the_lattice_of_the_sensor(lfcal: Lfcal, tmp_path: Path, pattern: str) -> None:
    """A plane of one colour is on the pixels of the sensor: no half pixel is lost, whichever filter comes first."""
    soft: dict[str, Any] = {"edges": (2.5,), "fill": 0.6, "snr": 1e4, "dead": 0.0, "falloff": 0.0}
    gains = np.array([{"R": 0.5, "G": 1.0, "B": 0.35}[colour] for colour in pattern]).reshape(2, 2)
    for pitch in (12.0, 13.4):
        truth = draw_white((150, 170), pitch, rotation=0.0, offset=(0.2, 0.35), **soft)
        np.save(tmp_path / "white.npy", (truth.frame - 100.0) * np.tile(gains, (75, 85)))
        for channel in ("R", "G", "B", ""):
            given = ("--channel", channel) if channel else ()
            found = lfcal("white", tmp_path / "white.npy", "--cfa", pattern, *given, "--json").ok().json
            assert truth.distance_to_lattice(tuple(found["origin_px"])) < 0.02, channel
            assert found["pitch_px"] == pytest.approx(pitch, abs=0.002)


# -- the files of a lattice -----------------------------------------------------------------------------------
SHAPE = (300, 360)


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the white image of a lattice with a barrel distortion of 2 px at the corner."""
    folder = tmp_path_factory.mktemp("bent")
    np.save(folder / "white.npy", draw_white(SHAPE, 12.3, bend=barrel(2.0, math.hypot(*SHAPE) / 2), seed=1).frame)
    return folder


def test_lattice_residuals_and_distortion_are_written_and_shown(lfcal: Lfcal, bent: Path, tmp_path: Path) -> None:
    shown = lfcal("white", bent / "white.npy", "-o", tmp_path).ok().out
    data = json.loads((tmp_path / "lattice.json").read_text())
    assert (data["format"], data["version"], data["form"]) == ("lfcal-lattice", 1, "radial")
    bend = data["distortion"]
    made = LatticeDistortion(bend["model"], bend["centre_px"], bend["scale_px"], bend["terms_px"])
    assert made.terms[0][0] == pytest.approx(2.0, abs=5 * data["errors"]["distortion_terms_px"][0][0])
    assert data["pitch_px"] == pytest.approx(12.3, abs=0.01)
    with (tmp_path / "residuals.csv").open(newline="") as table:
        lines = list(csv.DictReader(table))
    assert len(lines) == data["lenslets"] and sum(line["dead"] == "1" for line in lines) == len(data["dead"]) > 0
    assert all((line["residual_row_px"] == "") == (line["dead"] == "1") for line in lines)
    left = [float(line["residual_row_px"]) for line in lines if line["dead"] == "0"]
    assert math.sqrt(np.mean(np.square(left))) < 0.06 and (tmp_path / "residuals.png").stat().st_size > 5000
    for words in ("radial: removes", "±", "centre"):
        assert words in shown
    shown = " ".join(shown.split())
    assert "k1" not in shown, "coefficients are in the file"
    centre = re.search(r"pitch at the centre ([\d.]+) px", shown)
    low, high = re.search(r"pitch over the field ([\d.]+) to ([\d.]+) px", shown).groups()  # type: ignore[union-attr]
    # barrel of 2 px at the corner: d(2 u³)/dr is 0 in the middle, and largest far outside
    assert float(centre[1]) == pytest.approx(data["pitch_px"], abs=0.02)  # type: ignore[index]
    assert float(low) <= float(centre[1]) < float(high)  # type: ignore[index]
    assert "largest distortion 1." in shown or "largest distortion 2." in shown


@pytest.fixture(scope="module")
def fit(bent: Path) -> LatticeFit:
    return fit_lattice(np.load(bent / "white.npy"))


def test_a_lattice_is_saved_and_loaded_unchanged(fit: LatticeFit, tmp_path: Path) -> None:
    save_lattice(fit, tmp_path)
    again = load_lattice(tmp_path / "lattice.json")
    assert fit.distortion is not None and again.distortion == fit.distortion
    assert (again.kind, again.shape, again.form, again.reason) == (fit.kind, fit.shape, fit.form, fit.reason)
    q, r = fit.index.T
    np.testing.assert_allclose(again.centres_px(q, r), fit.centres_px(q, r), atol=1e-9)
    np.testing.assert_array_equal(again.index, fit.index)
    assert again.dead_lenslets == fit.dead_lenslets != []
    save_lattice(replace(fit, distortion=None), tmp_path)
    assert load_lattice(tmp_path / "lattice.json").distortion is None


CHANGES: tuple[dict[str, Any], ...] = (
    {"format": "lfcal-camera"},
    {"version": 2},
    {"kind": "round"},
    {"shape": [300]},
    {"shape": [3e9, 10]},
    {"pitch_px": 0.001},
    {"pitch_px": "12"},
    {"origin_px": None},
    {"dead": [[1, 2, 3]]},
    {"dead": {"a": 1}},
    {"distortion": [1]},
    {"distortion": {"model": "radial"}},
    {"distortion": {"model": "radial", "centre_px": [0, 0], "scale_px": 1.0, "terms_px": [["a"]]}},
)


def test_what_is_not_a_lattice_is_refused_in_one_line(fit: LatticeFit, tmp_path: Path) -> None:
    save_lattice(fit, tmp_path)
    path = tmp_path / "lattice.json"
    known = json.loads(path.read_text())
    texts = [json.dumps(known | change) for change in CHANGES]
    for text in (*texts, "[]", "{", '{"format": "lfcal-lattice", "version": 1}', "\x00"):
        path.write_text(text)
        with pytest.raises(FileFormatError) as caught:
            load_lattice(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value), text[:60]


@pytest.mark.long
def test_a_light_field_is_resampled_by_a_lattice_measured_before(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    white = draw_white((150, 160), 12.3, kind="square").frame
    tifffile.imwrite("white.tif", white)
    save_lattice(fit_lattice(white), tmp_path)
    save(PSFMatrix(np.random.default_rng(0).random((1, 12, 12, 9, 9)).astype(np.float32)), "H.h5")
    words = ("reconstruct", "H.h5", "white.tif", "-n", "2", "-o")
    both = ("--white", "white.tif", "--lattice", "lattice.json")
    lfcal(*words, "a.npy", "--resample", "always", *both[:2]).ok()
    lfcal(*words, "b.npy", "--resample", "always", *both).ok()
    np.testing.assert_allclose(np.load("b.npy"), np.load("a.npy"), rtol=1e-3)
    # a lattice that is given is there to resample by
    lfcal(*words, "c.npy", *both).ok()
    np.testing.assert_array_equal(np.load("c.npy"), np.load("b.npy"))
    lfcal(*words, "d.npy", *both[2:], "--resample", "never").refused("resample: expected auto or always")
