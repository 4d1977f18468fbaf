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
from lfcal.camera import Camera, ScanPlan
from lfcal.fit import Fit, Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.stored import StoredFit, read_fit
from lfcal.fit.validate import iter_validate
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.facts import Facts
from lfcal.simulate.effects import Crosstalk
from lfcal.simulate.effects.described import parse_entries
from lfcal.tasks import FitMatrix
from lfcal.tasks._patterns import PatternReading, iter_patterns
from tests.cli.conftest import Run
from tests.fit.commands import typed, undrawn
from tests.fit.common import few_patterns, setup_of, small_plan

Lfcal = Callable[..., Run]
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
    """Leave the pictures of the fit out, which were drawn already."""
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
    """What simulate computes of the two files is the model; the engines' settings are chosen anew."""
    found = whole[0] / "fit"
    settings, given = parse_entries(found / "effects.json")
    assert {"lens_types", "iris_shape"} <= settings.keys() | {one.name for one in given}
    assert set(settings.values()) == {"on"}
    with open_psf(found / "H.h5") as H:
        assert H.camera is not None
        (place / "plan.json").write_text(replace(small_plan(15, (2.2,)), camera=H.camera, period=(2, 4)).to_json())
        words = ("simulate", "plan.json", "--effect", found / "effects.json", "--tolerance", 0.01, "-o", "again.h5")
        made = lfcal(*words)
        assert made.code == 0, made.err
        with open_psf(place / "again.h5") as again:
            a, b = np.asarray(H), np.asarray(again)
    b *= (a * b).sum() / (b * b).sum()
    assert np.abs(a - b).sum() / np.abs(a).sum() < 0.012


@pytest.mark.usefixtures("plain_pages")
def test_frames_are_corrected_and_cut_out(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    (place / "plan.json").write_text(plan.to_json())
    assert lfcal("simulate", "plan.json", "--frames", "scan", "--level", "grid").code == 0
    (place / "scan" / "plan.json").rename(place / "kept.json")
    (place / "plan.json").unlink()
    more = ("--plan", "kept.json", "--dark", "scan/dark", "--positions", 0, "--orientation", "as-is")
    run = lfcal("fit", "scan/frames", *more, "--unknowns", "geometry", "--no-h", "--json")
    assert run.code == 0 and isinstance(run.json, dict), run.err
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
    again = lfcal("fit", "scan/frames", *more[:2], "--dark", "none", "--unknowns", "geometry", "--no-h", "-o", "b")
    assert (
        again.code == 2
        and "samples: expected samples without the black level, got samples that include it; subtract dark frames"
        in again.err
    )
    assert not (place / "b").exists()


def test_of_many_positions_some_are_taken(place: Path) -> None:
    how = PatternReading(most=5)
    found, known = drain(iter_patterns(place / "few.h5", how))
    assert len(found) == 5 and found.held_out.sum() == 1 and known == {"source": "few.h5"}
    for most in (0, 1000):
        assert len(drain(iter_patterns(place / "few.h5", replace(how, most=most)))[0]) == 6


@pytest.mark.long
def test_withheld_points_are_predicted(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    """Of another recording: at the same positions, but never fitted."""
    save(few_patterns(), place / "later.h5")
    assert lfcal("fit", "few.h5", "--no-h").code == 0
    run = lfcal("fit", "validate", "fit", "later.h5", "--other")
    assert run.code == 0 and "6 held-out points: error below" in run.out, run.err
    found = json.loads((place / "fit" / "validation.json").read_text())
    assert found["source"] == "later.h5"
    assert len(found["points"]) == 6 and found["errors"]["camera"]["all"]["limit"] < 0.03
    assert abs(np.mean([one["chi2"] for one in found["points"]]) - 1) < 0.4 and not found["period_lost"]
    picture = (place / "fit" / "report" / "validation.png").read_bytes()
    assert picture[:4] == b"\x89PNG"
    page = (place / "fit" / "report" / "index.html").read_text()
    assert b64encode(picture).decode() in page and page.count("<section") == 6 and page.rstrip().endswith("</html>")
    assert "Points that were not fitted" in page and "6 held-out points: error below" in page
    again = lfcal("fit", "validate", "fit", "later.h5", "--other")
    assert again.code == 2 and "exists; add --force" in again.err
    # once more is no second section
    assert lfcal("fit", "validate", "fit", "later.h5", "--other", "--force", "--positions", 4).code == 0
    page = (place / "fit" / "report" / "index.html").read_text()
    assert page.count("<section") == 6 and "4 held-out points" in page and "6 held-out points" not in page


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_a_plane_without_patterns_is_told(lfcal: Lfcal, place: Path) -> None:
    few = few_patterns()
    assert few.camera is not None and few.facts.noise is not None
    shape = (2, *few.shape[1:])
    values, recorded, noise = np.zeros(shape, np.float32), np.zeros(shape[:3], int), np.full((*shape[:3], 2), np.nan)
    values[0], recorded[0], noise[0] = np.asarray(few)[0], few.recorded[0], few.facts.noise[0]
    facts = Facts.of(shape[:3], shape[3:], recorded=recorded, noise=noise)
    depths = (float(few.depths[0]), few.camera.depth_of(2.3))
    save(PSFMatrix(values, depths=depths, camera=few.camera, anchor=few.anchor, facts=facts), place / "two.h5")
    run = lfcal("fit", "two.h5", "--unknowns", "geometry", "-o", "two", "--workers", "1")
    assert run.code == 0 and "note: plane 1: no pattern was recorded; H is that of the model" in run.err, run.err
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


def test_where_every_position_is_fitted_none_is_left_to_predict(
    lfcal: Lfcal, place: Path, whole: tuple[Path, str]
) -> None:
    shutil.copytree(whole[0] / "fit", place / "fit")
    run = lfcal("fit", "validate", "fit", "few.h5")
    assert (
        run.code == 2
        and "few.h5, recorded positions: expected at least one position that was not fitted, got none" in run.err
    )
    stored = read_fit(place / "fit")
    three = frozenset(sorted(stored.positions)[:3])
    how = PatternReading(fit=replace(stored, positions=three))
    rest = drain(iter_patterns(place / "few.h5", how))[0]
    assert len(rest) == 3 and not {tuple(at) for at in rest.index.tolist()} & three
    missing = lfcal("fit", "validate", "fit", "none.h5", "--other")
    assert missing.code == 2 and "none.h5" in missing.err and not (place / "fit" / "validation.json").exists()
    nowhere = lfcal("fit", "validate", "nowhere", "few.h5")
    assert nowhere.code == 2 and "nowhere" in nowhere.err and nowhere.err.count("\n") == 1
    two = lfcal("fit", "validate", "fit", "few.h5", "other.h5", "--other")
    assert two.code == 2, two.err


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


@pytest.mark.usefixtures("plain_pages")
def test_a_known_objects_frame_is_predicted(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    rng = np.random.default_rng(1)
    volume = (rng.random((1, 120, 120)) < 0.01) * rng.random((1, 120, 120)).astype(np.float32)
    np.save(place / "object.npy", volume.astype(np.float32))
    for name, gap in (("right.tif", GAP), ("wrong.tif", 1.06 * GAP)):
        cv2.imwrite(str(place / name), object_frame(volume, gap, 1.0).astype(np.uint16))
    words = ("--scene", "object.npy", "--noise", "16,1", "--black-level", 70, "--json")
    assert lfcal("fit", "few.h5").code == 0
    errors = {}
    for name in ("right.tif", "wrong.tif"):
        run = lfcal("fit", "object", "fit", name, *words)
        assert run.code == 0 and isinstance(run.json, dict), run.err
        errors[name] = run.json
    assert "right.tif: predicted with an error" in lfcal("fit", "object", "fit", "right.tif", *words[:-1]).out
    right, wrong = errors["right.tif"], errors["wrong.tif"]
    assert abs(right["chi2"] - 1) < 0.25 and max(right["error"]["value"], right["error"]["limit"]) < 0.04
    assert wrong["error"]["known"] and wrong["error"]["value"] > 0.08
    np.save(place / "small.npy", volume[:, :60])
    for more, what in (
        (("right.tif",), "Missing option '--scene'"),
        (("right.tif", "--scene", "small.npy"), "small.npy, volume: expected (1, 120, 120)"),
        (("none.tif", "--scene", "object.npy"), "none.tif"),
        (("right.tif", "--scene", "none.npy"), "none.npy"),
    ):
        run = lfcal("fit", "object", "fit", *more, "--black-level", 70)
        assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    (place / "fit" / "H.h5").unlink()
    bare = lfcal("fit", "object", "fit", "right.tif", *words)
    assert bare.code == 2 and "H.h5: expected H of the fit, got none" in bare.err


def simulated(plan: ScanPlan, index: np.ndarray) -> np.ndarray:
    """Return patterns of the camera as described, the brightest sample 1."""
    light = predict(setup_of(plan), plan, index, np.zeros((len(index), 2)), Fineness.fine)
    return light / light.max()


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--unknowns", "gap"), "--unknowns: expected auto or groups of unknowns, got gap; choose from geometry"),
        (("--unknowns", ","), "--unknowns: expected auto or groups"),
        (("--unknowns", "geometry,specimen"), "got specimen, which needs the effect index_mismatch"),
        (("--noise", "64"), "--noise: expected CONSTANT,SLOPE of the variance of a sample, got '64'"),
        (("--noise", "0,0"), "--noise: expected a variance above 0, got '0,0'; give a constant and a slope"),
        (("--noise=-1,1",), "--noise: expected a number ≥ 0, got -1"),
        (("--positions", 2), "recorded patterns: expected at least 3, got 2"),
        (("--camera", "nowhere.json"), "camera: expected"),
        (("--orientation", "sideways"), "--orientation: expected"),
        (("--out", "few.h5"), "few.h5"),
    ],
)
def test_bad_words_end_in_one_line(lfcal: Lfcal, place: Path, words: tuple[object, ...], what: str) -> None:
    run = lfcal("fit", "few.h5", *words)
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    assert [path.name for path in place.iterdir()] == ["few.h5"]


@pytest.mark.usefixtures("plain_pages")
def test_an_h_without_camera_or_noise_is_told_what_to_name(lfcal: Lfcal, place: Path, fitted: list[Measured]) -> None:
    data = few_patterns()
    plain = Facts.of(data.shape[:3], data.cutout, recorded=data.recorded)
    values = np.asarray(data)
    save(PSFMatrix(values, depths=data.depths, anchor=data.anchor, facts=plain), place / "bare.h5")
    run = lfcal("fit", "bare.h5")
    assert run.code == 2 and "bare.h5: expected an H with its camera, got an H without one; state the camera" in run.err
    assert data.camera is not None
    (place / "c.json").write_text(data.camera.to_json())
    run = lfcal("fit", "bare.h5", "--camera", "c.json")
    assert run.code == 2 and "state the noise (--noise CONSTANT,SLOPE)" in run.err, run.err
    guessed = replace(data.camera, marks=data.camera.marks.marked(["sensor.read_noise_e"], "assumed"))
    save(PSFMatrix(values, depths=data.depths, camera=guessed, anchor=data.anchor, facts=plain), place / "guess.h5")
    assert "got a sensor whose read noise or full well is assumed; state these values" in lfcal("fit", "guess.h5").err
    words = ("--camera", "c.json", "--noise", "64,1", "--unknowns", "geometry", "--no-h")
    run = lfcal("fit", "bare.h5", *words)
    assert run.code == 0, run.err
    assert (fitted[0].noise == (64, 1)).all() and fitted[0].plan.camera == data.camera
    assert "fitted" in json.loads((place / "fit" / "fit.json").read_text())
    again = lfcal("fit", "bare.h5", *words)
    assert again.code == 2 and "exists; add --force to replace it" in again.err
    (place / "fit" / "H.h5").write_text("of another camera")
    mixed = lfcal("fit", "bare.h5", *words, "--force")
    assert (
        mixed.code == 2
        and "H.h5: expected no file of H, because none is written now (--no-h), got H of an earlier fit" in mixed.err
    )


@pytest.mark.usefixtures("plain_pages")
def test_a_plan_says_what_an_h_of_nothing_but_values_does_not(
    lfcal: Lfcal, place: Path, fitted: list[Measured]
) -> None:
    few = few_patterns()
    assert few.camera is not None
    save(
        PSFMatrix(np.asarray(few), facts=Facts.of(few.shape[:3], few.cutout, recorded=few.recorded)), place / "bare.h5"
    )
    plan = ScanPlan(few.camera, few.period, few.cutout, tuple(few.depths), few.anchor)
    for name, one in (("plan.json", plan), ("other.json", replace(plan, period=(2, 3)))):
        (place / name).write_text(one.to_json())
    words = ("--noise", "64,1", "--unknowns", "geometry", "--hybrid")
    run = lfcal("fit", "bare.h5", "--plan", "plan.json", *words, "-o", "bare")
    assert run.code == 0 and lfcal("fit", "few.h5", *words, "-o", "whole").code == 0, run.err
    assert (
        fitted[0].plan == fitted[1].plan
        and (place / "bare" / "camera.json").read_text() == (place / "whole" / "camera.json").read_text()
    )
    wrong = lfcal("fit", "bare.h5", "--plan", "other.json", *words, "-o", "other")
    assert (
        wrong.code == 2
        and "expected a plan of the shape (1, 2, 4, 15, 15) of H, got one of shape (1, 2, 3, 15, 15)" in wrong.err
    )
    twice = lfcal("fit", "few.h5", "--plan", "plan.json", *words, "-o", "twice")
    assert (
        twice.code == 2 and "plan: expected an H without a camera, got few.h5, which contains its camera" in twice.err
    )


def test_other_files_are_no_h_and_no_frames(lfcal: Lfcal, place: Path) -> None:
    (place / "text.h5").write_text("no HDF5")
    for name in ("missing.h5", "missing", "text.h5"):
        run = lfcal("fit", name)
        assert run.code == 2 and run.err.count("\n") == 1 and name in run.err, run.err


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
        run = lfcal("fit", name)
        assert run.code == 2 and run.err.count("\n") == 1, run.err
        channel = "G1" if name == "mosaic" else "G"
        assert f"run lfcal assemble {name} --channel {channel} -o H.h5, then lfcal fit H.h5" in run.err
        typed = run.err.partition("run lfcal ")[2].partition(", then")[0]
        assert lfcal(*shlex.split(typed), "--orientation", "as-is", "--force", "--keep-pedestal").code == 0


@pytest.mark.long
def test_a_recorded_session_is_fitted(lfcal: Lfcal, place: Path) -> None:
    words = ("--positions", 12, "--unknowns", "geometry,focal_lengths,iris", "--no-h", "--json")
    run = lfcal("fit", SAMPLE / "recorded", *words)
    assert run.code == 0 and isinstance(run.json, dict), run.err
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
    run = lfcal("fit", "few.h5", "--unknowns", "geometry", "--no-h", "--workers", "1", *given)
    assert run.code == 0
    settings, effects = parse_entries(place / "fit" / "effects.json")
    assert Crosstalk(0.01) in effects and "exact_angles" not in settings and settings["lens_types"] == "on"
    bad = lfcal("fit", "few.h5", "-o", "other", "--effect", "shot_noise=on")
    assert bad.code == 2 and "effects of a fit: expected effects on the light of a point" in bad.err
    assert not (place / "other").exists()
