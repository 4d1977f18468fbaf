"""``lfcal fit``: from an H file or frames to camera, effects, numbers, H and a report."""

from __future__ import annotations

import json
import shlex
import shutil
from base64 import b64encode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import lfcal.fit
from lfcal.base.errors import InputError
from lfcal.base.progress import Work, drain
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.fit import Fit, Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.stored import StoredFit, read_fit
from lfcal.fit.validate import iter_validate
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.facts import Facts, Origin
from lfcal.simulate.effects import Crosstalk
from lfcal.simulate.effects.described import parse_entries
from lfcal.tasks import FitMatrix
from lfcal.tasks._patterns import PatternReading, iter_patterns
from tests.cli._building import CENTRES, DEPTHS, fourier_camera
from tests.cli.conftest import Lfcal
from tests.fit.commands import typed, undrawn
from tests.fit.common import few_patterns, setup_of, small_plan
from tests.psf.test_joining import contents

# -- ``lfcal fit``: from an H file or frames to camera, effects, numbers, H and a report --
FILES = ("H.h5", "camera.json", "effects.json", "fit.json", "report/index.html")
SAMPLE = Path(__file__).parents[2] / "sample_data"
GAP = 1.01
"""True gap of the few patterns over the described one."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path


FOUND: list[Fit] = []
"""The fit of the few patterns, once it was made."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder in which the few patterns were fitted, and what was said."""
    folder = tmp_path_factory.mktemp("whole")
    save(few_patterns(), folder / "few.h5")
    real = lfcal.fit.iter_fit_camera

    def kept(*words: Any, **options: Any) -> Work[Fit]:
        FOUND.append((yield from real(*words, **options)))
        return FOUND[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("lfcal.fit.iter_fit_camera", kept)
        said, _ = typed(folder, "fit", "few.h5", "--unknowns", "geometry,geometry", "--workers", 1)
    return folder, said


@pytest.fixture
def plain_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the pictures of the fit, which other tests draw."""
    undrawn(monkeypatch)


@pytest.fixture
def fitted(whole: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> list[Measured]:
    """Return a list of what is handed over to be fitted; the fit is the one that was made already."""
    seen: list[Measured] = []

    def again(measured: Measured, *words: Any, **options: Any) -> Work[Fit]:
        seen.append(measured)
        yield from ()
        return FOUND[0]

    monkeypatch.setattr("lfcal.fit.iter_fit_camera", again)
    return seen


def test_a_fit_writes_camera_effects_numbers_h_and_report(whole: tuple[Path, str]) -> None:
    place, out = whole
    assert all((place / "fit" / name).is_file() for name in FILES) and "gap_um" in out
    found = json.loads((place / "fit" / "fit.json").read_text())
    assert found["format"] == "lfcal-fit" and found["source"] == "few.h5" and found["verdict"] in out
    assert found["patterns"] == 6 and found["left_out_error"]["limit"] < 0.03 and found["complete"]
    gap = next(one for one in found["parameters"] if one["name"] == "gap_um")
    assert abs(gap["value"] - GAP * gap["start"]) < 4 * gap["sigma"] < 0.01 * gap["value"]
    described = few_patterns().camera
    assert described is not None
    camera = Camera.from_json((place / "fit" / "camera.json").read_text())
    assert camera.lattice.gap_um == gap["value"] and camera.sensor == described.sensor
    assert camera.marks["lattice.gap_um"] == "measured" and "optics.f_number" not in camera.marks.paths("measured")
    page = (place / "fit" / "report" / "index.html").read_text()
    assert page.count("data:image/png") == 3 and "gap_um" in page and "http" not in page.replace("http-equiv", "")
    with open_psf(place / "fit" / "H.h5") as H:
        assert H.shape == few_patterns().shape and len(H.missing) == 0 and H.camera == camera
        said = H.provenance
        assert said["source"] == "few.h5" and said["fit"]["chi2"] == pytest.approx(found["chi2"]["lit"])
        # every pattern is there, in the units of the data; those recorded are as good as their noise
        data = few_patterns()
        for z, y, x in np.argwhere(data.recorded > 0).tolist():
            noise = np.sqrt(64.0 + np.maximum(H[z, y, x], 0))
            assert np.square((data[z, y, x] - H[z, y, x]) / noise).mean() < 1.4
        assert all(H[0, y, x].sum() > 0 for y, x in np.ndindex(2, 4))


def test_the_camera_and_effects_make_the_same_h(lfcal: Lfcal, whole: tuple[Path, str], place: Path) -> None:
    """What simulate computes of the two files is the model; the engines' settings are chosen again."""
    found = whole[0] / "fit"
    settings, given = parse_entries(found / "effects.json")
    assert {"lens_types", "iris_shape"} <= settings.keys() | {one.name for one in given}
    assert set(settings.values()) == {"on"}
    camera = Camera.from_json((found / "camera.json").read_text())
    (place / "plan.json").write_text(replace(PLAN, camera=camera, period=(2, 4)).to_json())
    words = ("simulate", "plan.json", "--effect", found / "effects.json", "--tolerance", 0.01, "-o", "again.h5")
    lfcal(*words).ok()
    with open_psf(found / "H.h5") as H, open_psf(place / "again.h5") as again:
        a, b = np.asarray(H), np.asarray(again)
    b *= (a * b).sum() / (b * b).sum()
    assert np.abs(a - b).sum() / np.abs(a).sum() < 0.012


@pytest.mark.usefixtures("plain_pages")
def test_frames_are_corrected_and_cut_out(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    (place / "plan.json").write_text(plan.to_json())
    lfcal("simulate", "plan.json", "--frames", "scan", "--level", "grid").ok()
    (place / "scan" / "plan.json").rename(place / "kept.json")
    (place / "plan.json").unlink()
    more = ("--plan", "kept.json", "--dark", "scan/dark", "--positions", 0, "--orientation", "as-is")
    run = lfcal("fit", "scan/frames", *more, "--unknowns", "geometry", "--no-h", "--json")
    assert run.code == 0, run.err
    assert [Path(name).name for name in run.json["files"]] == ["index.html", *FILES[1:4]]
    assert run.err.startswith("lfcal: note: noise of the frames: as in the camera desc") and run.err.count("\n") == 1
    assert len(fitted) == 1 and len(fitted[0]) == 8 and fitted[0].patterns.shape[1:] == (15, 15)
    # the dark frame is subtracted, and patterns are those of the positions
    clean = simulated(plan, fitted[0].index)
    light = fitted[0].patterns / fitted[0].patterns.max()
    assert abs(np.median(fitted[0].patterns)) < 40 and np.square(light - clean).sum() < 2e-3 * np.square(clean).sum()
    assert not (place / "fit" / "H.h5").exists()
    said = json.loads((place / "fit" / "fit.json").read_text())
    assert said["corrections"] and said["orientation"]["applied"] == "as is"
    # noise is stated for light above the black level
    lfcal("fit", "scan/frames", *more[:2], "--dark", "none", "--unknowns", "geometry", "--no-h", "-o", "b").refused(
        "samples: expected samples without the black level, got samples that include it; subtract dark frames"
    )
    assert not (place / "b").exists()


def test_some_of_many_positions_are_used_and_none_is_left_to_predict(
    lfcal: Lfcal, place: Path, whole: tuple[Path, str]
) -> None:
    how = PatternReading(most=5)
    found, known = drain(iter_patterns(place / "few.h5", how))
    assert len(found) == 5 and found.held_out.sum() == 1 and known == {"source": "few.h5"}
    for most in (0, 1000):
        assert len(drain(iter_patterns(place / "few.h5", replace(how, most=most)))[0]) == 6
    shutil.copytree(whole[0] / "fit", place / "fit")
    stored = read_fit(place / "fit")
    three = frozenset(sorted(stored.positions)[:3])
    rest = drain(iter_patterns(place / "few.h5", PatternReading(fit=replace(stored, positions=three))))[0]
    assert len(rest) == 3 and not {tuple(at) for at in rest.index.tolist()} & three
    for words, said in (
        ("fit few.h5", "few.h5, recorded positions: expected at least one position that was not fitted, got none"),
        ("fit none.h5 --other", "none.h5"),
        ("nowhere few.h5", "nowhere"),
        ("fit few.h5 other.h5 --other", "other.h5"),
    ):
        lfcal("fit", "validate", *words.split()).refused(said)
    assert not (place / "fit" / "validation.json").exists()


@pytest.mark.long
def test_withheld_points_are_predicted(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    """Of another recording: at the same positions, but never fitted."""
    save(few_patterns(), place / "later.h5")
    lfcal("fit", "few.h5", "--no-h").ok()
    assert "6 held-out points: error below" in lfcal("fit", "validate", "fit", "later.h5", "--other").ok().out
    found = json.loads((place / "fit" / "validation.json").read_text())
    assert found["source"] == "later.h5"
    assert len(found["points"]) == 6 and found["errors"]["camera"]["all"]["limit"] < 0.03
    assert abs(np.mean([one["chi2"] for one in found["points"]]) - 1) < 0.4 and not found["period_lost"]
    picture = (place / "fit" / "report" / "validation.png").read_bytes()
    assert picture[:4] == b"\x89PNG"
    page = (place / "fit" / "report" / "index.html").read_text()
    assert b64encode(picture).decode() in page and page.count("<section") == 6 and page.rstrip().endswith("</html>")
    assert "Points that were not fitted" in page and "6 held-out points: error below" in page
    lfcal("fit", "validate", "fit", "later.h5", "--other").refused("exists; add --force")
    # once more is no second section
    lfcal("fit", "validate", "fit", "later.h5", "--other", "--force", "--positions", 4).ok()
    page = (place / "fit" / "report" / "index.html").read_text()
    assert page.count("<section") == 6 and "4 held-out points" in page and "6 held-out points" not in page


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_a_plane_without_patterns_is_named(lfcal: Lfcal, place: Path) -> None:
    few = few_patterns()
    shape = (2, *few.shape[1:])
    values, recorded, noise = np.zeros(shape, np.float32), np.zeros(shape[:3], int), np.full((*shape[:3], 2), np.nan)
    values[0], recorded[0], noise[0] = np.asarray(few)[0], few.recorded[0], few.facts.noise[0]
    facts = Facts.of(shape[:3], shape[3:], recorded=recorded, noise=noise)
    depths = (float(few.depths[0]), few.camera.depth_of(2.3))
    save(PSFMatrix(values, depths=depths, camera=few.camera, anchor=few.anchor, facts=facts), place / "two.h5")
    run = lfcal("fit", "two.h5", "--unknowns", "geometry", "-o", "two", "--workers", "1").ok()
    assert "note: plane 1: no pattern was recorded; H is that of the model" in run.err
    with open_psf(place / "two" / "H.h5") as H:
        light = np.asarray(H).sum((1, 2, 3, 4))
    assert 0.5 < light[1] / light[0] < 2


def test_a_fit_from_its_folder_predicts_as_it_did(whole: tuple[Path, str]) -> None:
    stored, direct = read_fit(whole[0] / "fit"), StoredFit.of(FOUND[0])
    later = drain(iter_patterns(whole[0] / "few.h5", PatternReading()))[0]
    found, wanted = (drain(iter_validate(fit, later, another=True)) for fit in (stored, direct))
    for one, other in zip(found.points, wanted.points, strict=True):
        assert one.model.error.squared == pytest.approx(other.model.error.squared, rel=1e-9, abs=1e-12)
        assert one.place_px == other.place_px and one.model.gain == pytest.approx(other.model.gain, rel=1e-12)
    assert stored.positions == direct.positions and stored.response == direct.response


def object_frame(volume: np.ndarray, gap: float, gain: float) -> np.ndarray:
    """Return the frame of a volume by the plain sum of its points' patterns, with a black level of 70."""
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    lattice = plan.camera.lattice
    true = replace(plan, camera=replace(plan.camera, lattice=replace(lattice, gap_um=gap * lattice.gap_um)))
    index = np.argwhere(np.ones(plan.shape[:3], bool))
    light = predict(setup_of(true), true, index, np.zeros((8, 2)), Fineness.fine).reshape(plan.shape[1:])
    whole = np.zeros((140, 140))
    for row, column in np.argwhere(volume[0] > 0).tolist():
        y, x = (row - round(plan.anchor[0])) % 2, (column - round(plan.anchor[1])) % 4
        whole[row + 3 : row + 18, column + 3 : column + 18] += volume[0, row, column] * light[y, x]
    whole = gain * np.maximum(whole[10:130, 10:130], 0)
    rng = np.random.default_rng(0)
    return np.rint(70 + rng.poisson(whole * 2500 / whole.max()) + 4 * rng.standard_normal(whole.shape))


@pytest.mark.usefixtures("plain_pages", "fitted")
def test_a_known_objects_frame_is_predicted(lfcal: Lfcal, place: Path) -> None:
    rng = np.random.default_rng(1)
    volume = (rng.random((1, 120, 120)) < 0.01) * rng.random((1, 120, 120)).astype(np.float32)
    np.save(place / "object.npy", volume.astype(np.float32))
    np.save(place / "small.npy", volume[:, :60])
    words = ("--scene", "object.npy", "--noise", "16,1", "--black-level", 70)
    lfcal("fit", "few.h5").ok()
    errors = {}
    for name, gap in (("right.tif", GAP), ("wrong.tif", 1.06 * GAP)):
        cv2.imwrite(str(place / name), object_frame(volume, gap, 1.0).astype(np.uint16))
        errors[name] = lfcal("fit", "object", "fit", name, *words, "--json").ok().json
    assert "right.tif: predicted with an error" in lfcal("fit", "object", "fit", "right.tif", *words).out
    right, wrong = errors["right.tif"], errors["wrong.tif"]
    assert abs(right["chi2"] - 1) < 0.25 and max(right["error"]["value"], right["error"]["limit"]) < 0.04
    assert wrong["error"]["known"] and wrong["error"]["value"] > 0.08
    for more, what in (
        (("right.tif",), "Missing option '--scene'"),
        (("right.tif", "--scene", "small.npy"), "small.npy, volume: expected shape (1, 120, 120)"),
        (("none.tif", "--scene", "object.npy"), "none.tif"),
        (("right.tif", "--scene", "none.npy"), "none.npy"),
    ):
        lfcal("fit", "object", "fit", *more, "--black-level", 70).refused(what)
    (place / "fit" / "H.h5").unlink()
    lfcal("fit", "object", "fit", "right.tif", *words).refused("H.h5: expected H of the fit, got none")


def simulated(plan: ScanPlan, index: np.ndarray) -> np.ndarray:
    """Return patterns of the camera as described, the brightest sample 1."""
    light = predict(setup_of(plan), plan, index, np.zeros((len(index), 2)), Fineness.fine)
    return light / light.max()


def test_wrong_options_end_in_one_line(lfcal: Lfcal, place: Path) -> None:
    for words, what in (
        ("--unknowns gap", "--unknowns: expected auto or groups of unknowns, got gap; choose from geometry"),
        ("--unknowns ,", "--unknowns: expected auto or groups"),
        ("--unknowns geometry,specimen", "got specimen, which needs the effect index_mismatch"),
        ("--noise 64", "--noise: expected CONSTANT,SLOPE of the variance of a sample, got '64'"),
        ("--noise 0,0", "--noise: expected a variance above 0, got '0,0'; give a constant and a slope"),
        ("--noise=-1,1", "--noise: expected a number ≥ 0, got -1"),
        ("--positions 2", "recorded patterns: expected at least 3, got 2"),
        ("--camera nowhere.json", "camera: expected"),
        ("--orientation sideways", "--orientation: expected"),
        ("--out few.h5", "few.h5"),
    ):
        lfcal("fit", "few.h5", *words.split()).refused(what)
        assert [path.name for path in place.iterdir()] == ["few.h5"], words
    (place / "text.h5").write_text("no HDF5")
    for name in ("missing.h5", "missing", "text.h5"):
        lfcal("fit", name).refused(name)


@pytest.mark.usefixtures("plain_pages")
def test_an_h_without_camera_or_noise_needs_options(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    data = few_patterns()
    plain = Facts.of(data.shape[:3], data.cutout, recorded=data.recorded)
    values = np.asarray(data)
    save(PSFMatrix(values, depths=data.depths, anchor=data.anchor, facts=plain), place / "bare.h5")
    lfcal("fit", "bare.h5").refused("bare.h5: expected an H with its camera, got an H without one; state the camera")
    (place / "c.json").write_text(data.camera.to_json())
    lfcal("fit", "bare.h5", "--camera", "c.json").refused("state the noise (--noise CONSTANT,SLOPE)")
    guessed = replace(data.camera, marks=data.camera.marks.marked(["sensor.read_noise_e"], "assumed"))
    save(PSFMatrix(values, depths=data.depths, camera=guessed, anchor=data.anchor, facts=plain), place / "guess.h5")
    assert "got a sensor whose read noise or full well is assumed; state these values" in lfcal("fit", "guess.h5").err
    words = ("fit", "bare.h5", "--camera", "c.json", "--noise", "64,1", "--unknowns", "geometry", "--no-h")
    lfcal(*words).ok()
    assert (fitted[0].noise == (64, 1)).all() and fitted[0].plan.camera == data.camera
    assert "fitted" in json.loads((place / "fit" / "fit.json").read_text())
    lfcal(*words).refused("exists; add --force to replace it")
    (place / "fit" / "H.h5").write_text("of another camera")
    said = "H.h5: expected no file of H, because none is written now (--no-h), got H of an earlier fit"
    lfcal(*words, "--force").refused(said)


@pytest.mark.usefixtures("plain_pages")
def test_a_plan_states_what_an_h_of_values_alone_lacks(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    few = few_patterns()
    facts = Facts.of(few.shape[:3], few.cutout, recorded=few.recorded)
    save(PSFMatrix(np.asarray(few), facts=facts), place / "bare.h5")
    plan = ScanPlan(few.camera, few.period, few.cutout, tuple(few.depths), few.anchor)
    for name, one in (("plan.json", plan), ("other.json", replace(plan, period=(2, 3)))):
        (place / name).write_text(one.to_json())
    words = ("--noise", "64,1", "--unknowns", "geometry", "--hybrid", "-o")
    lfcal("fit", "bare.h5", "--plan", "plan.json", *words, "bare").ok()
    lfcal("fit", "few.h5", *words, "whole").ok()
    assert fitted[0].plan == fitted[1].plan
    assert (place / "bare" / "camera.json").read_text() == (place / "whole" / "camera.json").read_text()
    said = "expected a plan of the shape (1, 2, 4, 15, 15) of H, got one of shape (1, 2, 3, 15, 15)"
    lfcal("fit", "bare.h5", "--plan", "other.json", *words, "other").refused(said)
    said = "plan: expected an H without a camera, got few.h5, which contains its camera"
    lfcal("fit", "few.h5", "--plan", "plan.json", *words, "twice").refused(said)


def test_frames_of_several_colours_are_refused_with_the_way_out(lfcal: Lfcal, place: Path) -> None:
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    mosaic = replace(plan, camera=replace(plan.camera, sensor=replace(plan.camera.sensor, cfa="GRBG")))
    rng = np.random.default_rng(0)
    for name, own, shape in (("mosaic", mosaic, (120, 120)), ("picture", plan, (120, 120, 3))):
        (place / name).mkdir()
        (place / name / "plan.json").write_text(own.to_json())
        for y, x in np.ndindex(2, 4):
            frame = rng.integers(0, 4000, shape).astype(np.uint16)
            cv2.imwrite(str(place / name / f"z0_y{y}_x{x}.png"), frame)
        run = lfcal("fit", name).refused()
        channel = "G1" if name == "mosaic" else "G"
        assert f"run lfcal assemble {name} --channel {channel} -o H.h5, then lfcal fit H.h5" in run.err
        typed = run.err.partition("run lfcal ")[2].partition(", then")[0]
        lfcal(*shlex.split(typed), "--orientation", "as-is", "--force", "--keep-pedestal").ok()


@pytest.mark.long
def test_a_recorded_session_is_fitted(lfcal: Lfcal, place: Path) -> None:
    words = ("--positions", 12, "--unknowns", "geometry,focal_lengths,iris", "--no-h", "--json")
    run = lfcal("fit", SAMPLE / "recorded", *words)
    assert run.code == 0, run.err
    assert run.json["patterns"] + len(run.json["outliers"]) == 12 and run.json["left_out_error"]["limit"] < 0.03
    assert abs(run.json["chi2"]["excess"]) < 5, "the noise of the frames is as it is stated"
    assert all(abs(one["value"] - one["start"]) < 0.02 * abs(one["start"]) + 0.02 for one in run.json["parameters"])


def test_noise_in_words() -> None:
    assert FitMatrix(sources="H.h5", noise="").noise is None
    assert FitMatrix(sources="H.h5", noise="64, 0.5").noise == (64.0, 0.5)
    for wrong in ("a,b", "1,2,3", ",", "0,0", "-1,1", "nan,1", (0.0, 0.0)):
        with pytest.raises(InputError, match="noise: expected"):
            FitMatrix(sources="H.h5", noise=wrong)


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_effects_are_given_beside_the_described_ones(place: Path, lfcal: Lfcal) -> None:
    given = ("--effect", "crosstalk=0.01", "--effect", "exact_angles=off")
    lfcal("fit", "few.h5", "--unknowns", "geometry", "--no-h", "--workers", "1", *given).ok()
    settings, effects = parse_entries(place / "fit" / "effects.json")
    assert Crosstalk(0.01) in effects and "exact_angles" not in settings and settings["lens_types"] == "on"
    lfcal("fit", "few.h5", "-o", "other", "--effect", "shot_noise=on").refused(
        "effects of a fit: expected effects on the light of a point"
    )
    assert not (place / "other").exists()


# -- ``lfcal fit`` with unusable files: one clear line, and nothing written --
Spoil = Callable[[Path], object]


def h_of(values: np.ndarray | None = None, facts: dict[str, Any] | None = None, **more: Any) -> PSFMatrix:
    """Return the few patterns with other values or facts."""
    data = few_patterns()
    known = {"recorded": data.recorded, "noise": data.facts.noise} | (facts or {})
    made = {"depths": data.depths, "camera": data.camera, "anchor": data.anchor} | more
    own = np.asarray(data) if values is None else np.asarray(values, np.float32)
    return PSFMatrix(own, facts=Facts.of(data.shape[:3], data.cutout, **known), **made)


def saved(make: Callable[[], PSFMatrix]) -> Spoil:
    return lambda path: save(make(), path)


def recorded(*places: int) -> np.ndarray:
    found = np.zeros(few_patterns().shape[:3], int)
    found.flat[list(places)] = 1
    return found


def no_noise() -> np.ndarray:
    return np.full((*few_patterns().shape[:3], 2), np.nan)


FEW = few_patterns
CASES: dict[str, tuple[Spoil, str]] = {
    "missing": (lambda path: None, "no such file"),
    "empty": (lambda path: path.write_bytes(b""), "expected an intact HDF5 file"),
    "cut short": (lambda p: (save(FEW(), p), p.write_bytes(p.read_bytes()[:9000])), "expected an intact HDF5 file"),
    "all zero": (saved(lambda: h_of(np.zeros(FEW().shape))), "light of the patterns: expected more light than"),
    "below its background": (saved(lambda: h_of(-np.asarray(FEW()))), "brighter than the background, got darker"),
    "scattered": (
        saved(lambda: h_of(4000 * np.random.default_rng(0).random(FEW().shape))),
        "expected patterns of a camera like 'bench'",
    ),
    "one position": (saved(lambda: h_of(facts={"recorded": recorded(0)})), "patterns: expected at least 3, got 1"),
    "no position": (saved(lambda: h_of(facts={"recorded": recorded()})), "patterns: expected at least 3, got 0"),
    "noise unknown": (saved(lambda: h_of(facts={"noise": no_noise()})), "state the noise (--noise CONSTANT,SLOPE)"),
    "all saturated": (
        saved(lambda: h_of(facts={"valid": np.zeros((1, 2, 4, 29), np.uint8)})),
        "patterns: expected valid pixels (not saturated, masked or padded), got none; reduce the exposure",
    ),
    "resampled": (saved(lambda: h_of(provenance={"cutout": {"scale": [1.1, 1.0]}})), "assemble them without resamp"),
    "a microscope": (
        saved(lambda: h_of(camera=preset("lfm_20x05"), depths=[-4000.0], anchor=(500.0, 500.0))),
        "size of the patterns of the camera 'lfm_20x05': expected about the 15 px of the cutout, got ",
    ),
}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) if n == "scattered" else n for n in CASES])
def test_h_files_that_cannot_be_fitted_end_in_one_line(lfcal: Lfcal, tmp_path: Path, name: str) -> None:
    spoil, what = CASES[name]
    spoil(tmp_path / "H.h5")
    words = ("fit", tmp_path / "H.h5", "--unknowns", "geometry", "--workers", 1, "-o", tmp_path / "fit")
    assert what in lfcal(*words).refused().err and not (tmp_path / "fit").exists()


def write_frames(folder: Path, count: int = 8) -> None:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for k in range(count):
        frame = rng.integers(0, 4000, (120, 120)).astype(np.uint16)
        cv2.imwrite(str(folder / f"z0_y{k // 4}_x{k % 4}.png"), frame)


def test_folders_without_frames_plan_or_positions_end_in_one_line(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = replace(small_plan(15, (2.2,)), period=(2, 4)).to_json()
    (tmp_path / "empty").mkdir()
    for name in ("frames", "numbered", "nested/frames", "damaged"):
        write_frames(tmp_path / name)
        if name != "frames":
            (tmp_path / name.partition("/")[0] / "plan.json").write_text(plan)
    for k, path in enumerate(sorted((tmp_path / "numbered").glob("*.png"))):
        path.rename(tmp_path / "numbered" / f"frame{k}.png")
    cv2.imwrite(str(tmp_path / "nested" / "dark.png"), np.zeros((120, 120), np.uint16))
    (tmp_path / "damaged" / "z0_y1_x1.png").write_bytes(b"")
    for name, what in (
        ("empty", "frames in"),
        ("frames", f"make a plan (lfcal plan CAMERA.json --virtual-depths 3,4 -o {tmp_path / 'frames' / 'plan.json'}"),
        ("nested", f"run lfcal fit {tmp_path / 'nested' / 'frames'}"),
        ("numbered", f"run lfcal assemble {tmp_path / 'numbered'} --order serpentine -o H.h5, then lfcal fit H.h5"),
        ("damaged", "or leave it out (lfcal assemble --skip-damaged)"),
    ):
        words = ("--positions", 0, "--orientation", "as-is", "--no-h", "-o", tmp_path / "fit")
        run = lfcal("fit", tmp_path / name, *words).refused(what)
        # neither lists nor orders nor patterns are options here
        mine = run.err.splitlines()[-1].partition("run lfcal assemble")[0]
        assert not any(o in mine for o in ("--manifest", "--order", "--pattern")) and not (tmp_path / "fit").exists()


def test_the_command_that_does_what_is_missing_is_named(lfcal: Lfcal, place: Path) -> None:
    (place / "plan.json").write_text(replace(small_plan(15, (2.2,)), period=(2, 4)).to_json())
    lfcal("simulate", "plan.json", "--frames", "my scan", "--level", "grid").ok()
    assert "run lfcal fit 'my scan/frames' --dark 'my scan/dark'" in lfcal("fit", "my scan").err
    # names of which some are like none of the others
    (place / "my scan" / "frames" / "manifest.csv").unlink()
    cv2.imwrite("my scan/frames/lamp.png", np.zeros((120, 120), np.uint16))
    said = lfcal("fit", "my scan/frames").err
    assert "run lfcal assemble 'my scan/frames' --pattern 'z0_y{y}_x{x}.png' -o H.h5, then lfcal fit H.h5" in said
    typed = said.partition("run lfcal ")[2].partition(", then lfcal ")
    lfcal(*shlex.split(typed[0]), "--orientation", "as-is").ok()
    said = lfcal("fit", "my scan/frames/lamp.png", "--plan", "plan.json").err
    assert "run lfcal assemble 'my scan/frames/lamp.png' --plan plan.json --manifest LIST.csv -o H.h5, then" in said


def test_frames_of_fewer_bits_than_described_have_no_known_noise(lfcal: Lfcal, tmp_path: Path) -> None:
    write_frames(tmp_path / "frames")
    for path in (tmp_path / "frames").iterdir():
        cv2.imwrite(str(path), (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) >> 4).astype(np.uint8))
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    (tmp_path / "frames" / "plan.json").write_text(plan.to_json())
    lfcal("fit", tmp_path / "frames", "--orientation", "as-is", "--no-h", "-o", tmp_path / "fit").refused(
        "state the noise (--noise CONSTANT,SLOPE)"
    )


# -- ``lfcal fit --hybrid`` and ``lfcal assemble --fill``: what a fit adds to what was recorded, and how it is marked --
PLAN = replace(small_plan(15, (2.2,)), period=(4, 5))
FIT = ("--unknowns", "geometry", "--workers", 1)


CORRECTED = ("--dark", "scan/dark", "--orientation", "as-is")


@pytest.fixture(scope="module")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with simulated frames of which five are missing, and the fit of what is there."""
    place = tmp_path_factory.mktemp("fitted")
    (place / "plan.json").write_text(PLAN.to_json())
    typed(place, "simulate", "plan.json", "--frames", "scan", "--level", "grid", "--workers", 1)
    (place / "plan.json").unlink()
    for y, x in ((0, 1), (1, 3), (2, 0), (2, 4), (3, 2)):
        (place / "scan" / "frames" / f"z0_y{y:02d}_x{x:02d}.png").unlink()
    # it would name them
    for listed in (place / "scan" / "frames").glob("manifest.*"):
        listed.unlink()
    typed(place, "fit", "scan/frames", *CORRECTED, *FIT, "--positions", 0, "--no-h", drawn=False)
    return place


@pytest.fixture
def scan(place: Path, sparse: Path) -> Path:
    """Return the folder of the frames, next to that of their fit."""
    shutil.copytree(sparse, place, dirs_exist_ok=True)
    return place / "scan"


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_missing_positions_are_filled_and_marked(lfcal: Lfcal, place: Path, scan: Path) -> None:
    bare = lfcal("assemble", "scan/frames", *CORRECTED, "-o", "bare.h5", "--dtype", "float32")
    assert bare.code == 0 and "Positions without a frame: 5 positions" in bare.out, bare.err
    assert "fill them (lfcal assemble --fill FIT)" in bare.out
    words = ("assemble", "scan/frames", *CORRECTED, "--fill", "fit", "--dtype", "float32", "--workers", 1)
    run = lfcal(*words, "-o", "H.h5").ok()
    assert "5 of the missing positions are filled by the model of the fit, and marked" in run.err + run.out
    check = lfcal("verify", "H.h5", "--json")
    assert check.code == 0 and check.json["deviations"] == [] and check.json["missing"] == 5
    lfcal("simulate", "scan/plan.json", "--level", "grid", "-o", "truth.h5", "--workers", 1).ok()
    with open_psf("H.h5") as H, open_psf("bare.h5") as other, open_psf("truth.h5") as true:
        missing = H.recorded == 0
        assert missing.sum() == 5 and H.facts.origin is not None
        np.testing.assert_array_equal(H.facts.origin, np.where(missing, Origin.MODEL, Origin.MEASURED))
        values, measured = np.asarray(H), np.asarray(other)
        # what was recorded is as it was
        np.testing.assert_array_equal(values[~missing], measured[~missing])
        assert not measured[missing].any()
        found, wanted = values[missing].astype(float), np.asarray(true)[missing].astype(float)
        # in the units of the frames: by the light of what was recorded
        wanted *= measured[~missing].sum(dtype=float) / np.asarray(true)[~missing].sum(dtype=float)
        off = np.sqrt(np.square(found - wanted).sum() / np.square(wanted).sum())
        assert off < 0.03
        z, y, x = np.argwhere(missing)[0].tolist()
        sigma = H.uncertainty(z, y, x)
        assert sigma is not None and sigma.max() > 0 and H.provenance["filled"]["fit"] == "fit"
        noise = H.uncertainty(*np.argwhere(~missing)[0].tolist())
        assert noise is None or np.all(noise > 0)
    plain = lfcal(*words, "-o", "H2.h5", "--json")
    assert plain.json["filled"] == 5 and len(plain.json["missing"]) == 5


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_a_fit_of_a_filled_h_takes_what_was_recorded(lfcal: Lfcal, place: Path, scan: Path) -> None:
    """The model is no measurement."""
    words = ("assemble", "scan/frames", *CORRECTED, "--fill", "fit", "--dtype", "float32", "--workers", 1)
    lfcal(*words, "-o", "H.h5").ok()
    again = lfcal("fit", "H.h5", *FIT, "--noise", "100,1", "--positions", 0, "--no-h", "-o", "again", "--json")
    assert again.code == 0, again.err
    assert again.json["patterns"] + len(again.json["outliers"]) == 15


def test_a_fit_that_does_not_belong_is_not_used_to_fill(lfcal: Lfcal, place: Path, scan: Path) -> None:
    path = place / "fit" / "fit.json"
    kept = json.loads(path.read_text())
    camera = json.loads((place / "fit" / "camera.json").read_text())

    def told(what: str, change: dict[str, object] | None = None, text: str | None = None) -> None:
        path.write_text(json.dumps(kept | (change or {})) if text is None else text)
        run = lfcal("assemble", "scan/frames", *CORRECTED, "--fill", "fit", "-o", "H.h5")
        said = [line for line in run.err.splitlines() if "note: " not in line]
        assert run.code == 2 and len(said) == 1 and what in said[0], run.err
        assert not list(place.glob("H.h5*"))

    told("fit, period", {"scan": kept["scan"] | {"period": [9, 5]}})
    told("fit, depths", {"depths_um": [kept["depths_um"][0] + 50.0]})
    told("fit, anchor", {"scan": kept["scan"] | {"anchor": [3.0, 4.0]}})
    told("the results of a fit", {"gains": ["much"]})
    told("the results of a fit", {"gains": []})
    told("a result of an older version of lfcal", None, json.dumps({k: v for k, v in kept.items() if k != "scan"}))
    told('"lfcal-fit", version 1', None, "{}")
    told("fit.json", None, "no JSON")
    told("light as in the frames of plane 0", {"gains": [1.5 * kept["gains"][0]]})
    told("at least one fitted pattern", {"positions": []})
    camera["lattice"]["offset_um"] = [camera["lattice"]["offset_um"][0] + 25.0, camera["lattice"]["offset_um"][1]]
    (place / "fit" / "camera.json").write_text(json.dumps(camera))
    told("the fit of the camera that recorded plane 0")
    (place / "fit" / "camera.json").unlink()
    told("camera.json")
    run = lfcal("assemble", "scan/frames", *CORRECTED, "--fill", "nowhere", "-o", "H.h5")
    assert run.code == 2 and "nowhere" in run.err.splitlines()[-1]


@pytest.mark.long
def test_h_is_the_hybrid_of_all_that_was_recorded(lfcal: Lfcal, place: Path) -> None:
    """A pattern more that the model lacks at each position; all are used, though few are fitted."""
    data = few_patterns()
    (place / "few.h5").unlink()
    values = np.asarray(data) + 400.0 * (data.recorded > 0)[..., None, None] * (np.indices((15, 15)).sum(0) % 4 == 0)
    facts = Facts.of(data.shape[:3], data.cutout, **data.facts.known())
    save(PSFMatrix(values, depths=data.depths, camera=data.camera, anchor=data.anchor, facts=facts), place / "few.h5")
    run = lfcal("fit", "few.h5", *FIT, "--positions", 4, "--hybrid").ok()
    assert "6 positions changed by" in run.out + run.err
    said = json.loads((place / "fit" / "fit.json").read_text())
    assert said["patterns"] <= 4 and said["hybrid"]["hybrid"] == 6 and said["hybrid"]["model"] == 2
    page = (place / "fit" / "report" / "index.html").read_text()
    assert "6 positions changed by" in page
    lfcal("verify", "fit/H.h5").ok()
    with open_psf("fit/H.h5") as H:
        np.testing.assert_array_equal(H.recorded, data.recorded)
        assert H.facts.origin is not None and H.provenance["hybrid"]["hybrid"] == 6
        np.testing.assert_array_equal(H.facts.origin > 1, data.recorded == 0)
        there = data.recorded > 0
        lfcal("fit", "few.h5", *FIT, "--positions", 4, "-o", "plain").ok()
        with open_psf("plain/H.h5") as plain:
            near, far = (np.square(np.asarray(one) - values)[there].sum() for one in (H, plain))
            assert near < 0.5 * far
    lfcal("fit", "few.h5", "--hybrid", "--no-h", "-o", "c").refused("--hybrid: expected an H to write")
    assert not (place / "c").exists()


# -- ``lfcal fit`` of a Fourier light-field microscope: the recorded z stack of a bead, by every route --


@pytest.fixture
def stack(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder: the frames of three planes, and a plan whose lenslets are 6 µm off."""
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    for name, centres in (("true", CENTRES), ("plan", ((-216.0, 24.0), (186.0, -56.0)))):
        plan = ScanPlan.for_camera(fourier_camera(centres), depths_um=DEPTHS, cutout=(121, 131))
        (tmp_path / f"{name}.json").write_text(plan.to_json())
    lfcal("simulate", "true.json", "--frames", "stack", "--tolerance", 0.02).ok()
    return tmp_path


def found(folder: Path) -> dict[str, Any]:
    numbers: dict[str, Any] = json.loads((folder / "fit.json").read_text())
    del numbers["fitted"], numbers["task"]
    return numbers


FOURIER = ("fit", "stack/frames", "--plan", "plan.json", "--dark", "stack/dark", "--orientation", "as-is")


@pytest.mark.long
def test_the_lenslets_of_a_fourier_microscope_are_found(lfcal: Lfcal, stack: Path) -> None:
    lfcal(*FOURIER, "--unknowns", "lens_centres,travel_tilt").ok()
    with open_psf(stack / "fit" / "H.h5") as H:
        assert H.camera == Camera.from_json((stack / "fit" / "camera.json").read_text())
    true = {f"lenslet_{k}_{axis}_um": c for k, one in enumerate(CENTRES) for axis, c in zip("xy", one, strict=True)}
    true |= {"travel_rows_rad": 0.0, "travel_columns_rad": 0.0}
    parameters = found(stack / "fit")["parameters"]
    assert {one["name"] for one in parameters} == true.keys()
    for one in parameters:
        assert abs(one["value"] - true[one["name"]]) < 4.5 * one["sigma"], one


@pytest.mark.long
def test_unknowns_are_chosen_and_h_is_computed_in_units(lfcal: Lfcal, stack: Path) -> None:
    for out, more in (("whole", ()), ("parts", ("--executor", "threads"))):
        lfcal(*FOURIER, "-o", out, *more).ok()
    assert found(stack / "whole") == found(stack / "parts") and "lens_centres" in found(stack / "whole")["groups"]
    assert contents(stack / "whole" / "H.h5") == contents(stack / "parts" / "H.h5")
