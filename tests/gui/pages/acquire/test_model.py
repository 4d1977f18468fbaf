"""Settings, live pictures and stations of Record > Rig, without a window."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire import Control
from lfcal.acquire.setup import OpticalAxis, fit_stage, iter_stage_fit
from lfcal.acquire.setup.live import predicted_image
from lfcal.acquire.spots import find_spot
from lfcal.base import InputError, drain
from lfcal.camera import ScanPlan, StageAxes, preset
from lfcal.devices import simulated_rig
from lfcal.psf import PSFMatrix
from lfcal.simulate import sample_session
from lfcal.tasks import Acquire
from lfcal_gui.pages.acquire import _measuring, model_live
from lfcal_gui.pages.acquire.model import FIELDS, MORE, UNTIL, AcquireSettings, target_of
from lfcal_gui.pages.acquire.model_folder import folder_state
from lfcal_gui.pages.acquire.model_recorder import Recorder, record_picture
from lfcal_gui.pages.acquire.model_station import Station, cut, open_station, read_target
from tests.acquire.rigs import small_plan

PLAN = small_plan((3, 4), 2)


@pytest.fixture
def station() -> Station:
    return Station(simulated_rig(PLAN), "sim", PLAN)


def test_every_field_changes_one_thing() -> None:
    values = AcquireSettings().values(PLAN)
    assert set(values) == {spec.key for spec in (*FIELDS, *MORE, *UNTIL)}
    as_given: dict[str, object] = {
        **{"order": "coarse", "frames_averaged": 4, "bracket": "1, 0.5", "darks": 5, "dark_every": 7, "controls": 1},
        **{"reference_every": 9, "retries": 0, "on_suspect": "flag", "margin": 2, "keep_free": 0.5, "most": 40},
        **{"suspend": "temperature=20:22; lamp=90:", "check_stage": False, "check_origin": False, "cover": True},
        "positions": "half.json",
    }
    rewritten = {
        **{"tolerance": ("1,1,2", "1, 1, 2"), "overshoot": ("0,0,0", "0, 0, 0"), "until_error": ("1%", "1 %")},
        **{"unknowns": ("iris, distance", "iris,distance"), "origin": ("1, -2.5,3", "1, -2.5, 3")},
    }
    for key, (value, shown) in ({key: (value, value) for key, value in as_given.items()} | rewritten).items():
        settings, plan = AcquireSettings().changed_on(PLAN, key, value)
        assert settings.values(plan) == values | {key: shown}, key
    assert AcquireSettings(order="coarse").options().order == "coarse"
    settings, plan = AcquireSettings(order="coarse").changed_on(PLAN, "order", "raster")
    assert (settings.order, plan.order) == (None, "raster")
    refused = {"bracket": "0.5", "darks": -1, "until_error": "0.05%", "most": 11, "extent": "half", "overshoot": "1"}
    for key, bad in (*refused.items(), ("frames_averaged", 0), ("origin", "1,2"), ("origin", ""), ("unknowns", "x")):
        with pytest.raises(InputError):
            AcquireSettings().changed_on(PLAN, key, bad)


def test_a_live_picture_counts_every_pixel_and_predicts_the_cutout(station: Station) -> None:
    station.move(target_of(PLAN, 1))
    pace = model_live.Pace()
    picture = model_live.live_picture(station.look(PLAN.exposures[1], PLAN), PLAN, None, PLAN.exposures[1], pace)
    assert picture.frame is not None and picture.readout.endswith("0 saturated") and picture.caption == "Live"
    assert int((picture.frame >= 4095).sum()) == 0
    assert picture.window is not None and picture.seen is not None and picture.point is not None
    nt, ns = PLAN.cutout
    assert picture.seen.shape == (nt, ns)
    expected = PLAN.image_px(np.array([1, 1, 2]))
    assert picture.point == pytest.approx(tuple(expected), abs=0.05)
    row, column = picture.window[:2]
    np.testing.assert_array_equal(
        picture.seen - picture.seen.min(),
        cut(picture.frame, row, column, (nt, ns)) * 1.0 - cut(picture.frame, row, column, (nt, ns)).min(),
    )
    assert "centroid" in picture.spot and picture.predicted is not None and -1 <= picture.correlation <= 1
    bright = model_live.live_picture(station.look(10.0, PLAN), PLAN, None, 10.0, pace)
    share = 100 * (bright.frame >= 4095).sum() / bright.frame.size
    rate, exposure, *_ = bright.readout.replace("\n", "   ").split("   ")
    assert bright.readout.endswith(f"{share:.2g} % saturated") and "peak 100 % of range" in bright.readout
    assert rate.endswith(" frames/s") and exposure == "10 s"


def test_the_prediction_is_the_nearest_position_of_the_reference(station: Station) -> None:
    rng = np.random.default_rng(0)
    reference = PSFMatrix(rng.random(PLAN.shape).astype(np.float32))
    stage = PLAN.stage_um(np.array([1, 2, 3]))
    point = PLAN.image_px(np.array([1, 2, 3]))
    found = model_live.predicted_pattern(PLAN, reference, tuple(stage), tuple(point))
    np.testing.assert_array_equal(found, reference[1, 2, 3])
    there = (float(point[0]) + PLAN.period[0], float(point[1]) - PLAN.period[1])
    found = model_live.predicted_pattern(PLAN, reference, tuple(stage), there)
    np.testing.assert_array_equal(found, reference[1, 2, 3], err_msg="whole periods away it is the same")


def test_nothing_is_expected_between_the_planes(station: Station) -> None:
    reference = PSFMatrix(np.ones(PLAN.shape, np.float32))
    point = tuple(PLAN.image_px(np.array([1, 2, 3])))
    x, y, depth = PLAN.stage_um(np.array([1, 2, 3]))
    step = float(np.abs(np.diff(PLAN.depths_um)).min())
    for off, expected in ((0.4, True), (-0.4, True), (40.0, False), (-40.0, False)):
        there = (x, y, depth + off * step)
        for known in (reference, None):
            assert (model_live.predicted_pattern(PLAN, known, there, point) is not None) is expected
    picture = model_live.LivePicture(None, "", "", (x, y, depth + 40 * step))
    assert model_live.expected_words(picture, PLAN) == "No plane of the plan is near this depth."
    assert model_live.plane_to_go(picture, PLAN) == 1, "the last one"
    assert model_live.plane_to_go(replace(picture, stage_um=(x, y, depth)), PLAN) is None
    single = replace(PLAN, depths_um=PLAN.depths_um[:1], exposure_s=0.01)
    assert model_live.plane_at(single, single.depths_um[0]) == 0 and model_live.plane_at(single, 0.0) is None
    fourier = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=(0.0,))
    assert model_live.plane_at(fourier, 2.0) == 0 and model_live.plane_at(fourier, 40.0) is None


def test_cut_fills_with_zeros_beyond_the_frame() -> None:
    frame = np.arange(12).reshape(3, 4)
    padded = np.pad(frame, 5)
    for row, column in ((-2, -1), (0, 0), (2, 3), (-9, 0), (1, -2)):
        expected = padded[max(row, -5) + 5 :, max(column, -5) + 5 :][:3, :3] if row >= -5 else np.zeros((3, 3))
        np.testing.assert_array_equal(cut(frame, row, column, (3, 3)), expected)


@pytest.mark.parametrize(("right", "down"), [("+x", "+y"), ("-x", "+y"), ("-y", "+x"), ("+y", "-x"), ("+x", "-z")])
def test_arrows_point_where_the_image_goes(right: str, down: str) -> None:
    away = "+" + ({"x", "y", "z"} - {right[1], down[1]}).pop()
    plan = replace(PLAN, stage=StageAxes(right, down, away))
    still = np.array(predicted_image(plan, (0.0, 0.0, 0.0)))
    arrows = model_live.stage_arrows(plan.stage)
    assert [words for words, *_ in arrows] == sorted("+" + axis[1] for axis in (right, down))
    for words, *direction in arrows:
        stage = [0.0, 0.0, 0.0]
        stage["xyz".index(words[1])] = 50.0
        move = np.array(predicted_image(plan, (stage[0], stage[1], stage[2]))) - still
        np.testing.assert_allclose(move / np.linalg.norm(move), direction, atol=1e-9)


def test_a_wrong_sign_is_said_and_findings_have_their_units() -> None:
    positions = np.array([[0, 0, 0], [0, 0, 3], [0, 2, 0], [0, 2, 3]])
    stage, image = PLAN.stage_um(positions), PLAN.image_px(positions)
    words, good = _measuring.fit_words(fit_stage(PLAN, 0, stage, image), PLAN)
    assert good and "moves the image as planned" in words
    mirrored = image.copy()
    mirrored[:, 1] = 2 * mirrored[:, 1].mean() - mirrored[:, 1]
    words, good = _measuring.fit_words(fit_stage(PLAN, 0, stage, mirrored), PLAN)
    assert not good and "wrong direction" in words and "mirrored" in words
    assert "px rms" in _measuring.axis_words(OpticalAxis((1.0, -2.0), (40.0, 50.0), 0.1), PLAN)
    words = _measuring.exposure_words((0.01, 0.02), PLAN)
    assert "10 ms" in words and "20 ms" in words
    with pytest.raises(InputError):
        target_of(PLAN, 9)
    mirrored = replace(PLAN, stage=StageAxes("-x", "+y", "+z"))
    assert target_of(mirrored, 0)[0] == pytest.approx(-target_of(PLAN, 0)[0])


def test_moves_stay_within_the_limits_and_axes_without_a_number_stay(station: Station) -> None:
    before = station.position()
    with pytest.raises(InputError, match="nothing was moved"):
        station.move((1e9, 0.0, 0.0))
    with pytest.raises(InputError):
        station.move((math.nan, 0.0, 0.0))
    assert station.position() == before
    after = station.jog(1, 25.0)
    assert after[1] - before[1] == pytest.approx(25, abs=0.1)
    station.move((40.0, -30.0, 0.0))
    x, y, z = station.move_axes((None, 20.0, None))
    assert (x, y, z) == pytest.approx((40.0, 20.0, 0.0), abs=0.1)


def test_a_position_is_read_and_refused_in_a_line() -> None:
    limits = ((-100.0, 100.0), (-50.0, 50.0), (0.0, 2000.0))
    assert read_target("10, -20,1500", limits) == (10.0, -20.0, 1500.0)
    assert read_target(" 1 2 3 ", limits) == (1.0, 2.0, 3.0)
    assert read_target(", ,1500", limits) == (None, None, 1500.0)
    for words, told in (
        ("", "an empty value"), ("1, 2", "'1, 2'"), ("a, b, c", "x, y and z in µm"), (",,", "an empty value"),
        ("nan, 0, 0", "stage axis x: expected a number"), ("0, 51, 0", "axis y: expected -50 to 50 µm, got 51 µm"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=told) as caught:
            read_target(words, limits)
        assert "\n" not in str(caught.value)


def test_stations_open_and_refuse() -> None:
    found = open_station(PLAN, "sim", {"axes": "-x,+y,+z"})
    assert "96 × 96 px" in found.title
    found.close()
    with pytest.raises(InputError):
        open_station(PLAN, "sim", {"nonsense": "1"})


def test_a_recording_becomes_pictures(station: Station, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    assert folder_state(str(folder)).words() == "a new session"
    task = Acquire(plan="plan.json", out=folder, order="coarse", reference_every=8, keep_free=0)
    recorder = Recorder(task, PLAN, task.options())
    recorder.control = Control()
    work = recorder.work(station)
    for record in work:
        if record.stage == "record" and record.done >= 3:
            recorder.control.stop()
    part = folder_state(str(folder))
    assert 3 <= part.there.sum() < 24 and not part.complete
    assert "of 24 positions safe" in part.words() and "stopped" in part.words()

    again = Recorder(task, PLAN, task.options(), resume=True)
    drain(again.work(station))
    whole = folder_state(str(folder))
    assert whole.complete and whole.planes() == (0, 1)
    quality = again.quality.state(1)
    picture = record_picture(quality, again.order, 1, "energy", part.there)
    assert picture.complete and picture.done == picture.total == 24
    assert record_picture(quality, again.order, 1, "energy", None).done == 24 - part.there.sum()
    x, y = picture.curves["energy"]
    assert len(x) == quality.done and x.min() > part.there.sum() - 1, "the order of recording, not of the plan"
    expected = quality.energy.ravel()[again.order]
    np.testing.assert_array_equal(y, expected[np.isfinite(expected)])
    assert picture.depth_sum.shape == quality.depth_sums.shape[1:]
    assert picture.lamp.endswith("4 references"), "also those of the first run"
    assert set(picture.curves) == {"energy", "residual", "saturated"}


def test_sessions_that_the_page_does_not_record_are_named(tmp_path: Path) -> None:
    (tmp_path / "regions.json").write_text("{}")
    state = folder_state(str(tmp_path))
    assert "several regions" in state.problem and "lfcal acquire --resume" in state.words() and not state.complete


@pytest.fixture(scope="module")
def sample() -> ScanPlan:
    return ScanPlan.from_json((sample_session() / "plan.json").read_text())


def seen(sample: ScanPlan, **options: str) -> np.ndarray:
    """Return the live frame of a source on the axis, in the first plane."""
    station = open_station(sample, "sim", options)
    station.move((0.0, 0.0, sample.depths_um[0]))
    frame = station.look(sample.exposures[0], sample).frame
    station.close()
    return np.asarray(frame.data)


def test_the_simulator_shows_plenoptic_images_that_can_be_measured(sample: ScanPlan) -> None:
    found = seen(sample)
    np.testing.assert_array_equal(found, seen(sample, optics="auto", effects="auto"))
    assert not np.array_equal(found, seen(sample, optics="pattern"))
    assert find_spot(found).snr > 100
    with pytest.raises(InputError, match="no significant light"):
        find_spot(seen(sample, optics="auto"))
    station = open_station(sample, "sim", {})
    fit = drain(station.use(iter_stage_fit(station.rig, sample)))
    station.close()
    assert fit.scale == pytest.approx((1, 1), abs=0.02)
