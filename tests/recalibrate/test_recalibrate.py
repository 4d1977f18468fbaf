"""Recalibration of a small camera, and the results that it must not accept."""

from __future__ import annotations

import importlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import InputError, Work, drain
from lfcal.base.notes import notes_to
from lfcal.camera import NoLatticeError, ScanPlan, preset
from lfcal.fit import NewFrame
from lfcal.fit.model import Fineness
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.recalibrate import Contents, Recalibration, iter_recalibrate, recalibrate
from lfcal.recalibrate._frames import distinct_label
from lfcal.recalibrate._patterns import every_voxel, patterns_at
from lfcal.recalibrate._steps import Steps
from lfcal.recalibrate.score import Goodness
from tests.recalibrate.common import (
    GROUPS,
    WRONG,
    beads,
    described,
    frame_of,
    small_plan,
    the_window,
    true_patterns,
    true_setup,
)

PLAN = small_plan()
MODULE = importlib.import_module("lfcal.recalibrate._frames")
FIT, WINDOW = (importlib.import_module(f"lfcal.recalibrate.{name}") for name in ("recalibrate", "_window"))


def fitted(*frames: NewFrame, **options: object) -> Recalibration:
    return recalibrate(frames, PLAN, unknowns=GROUPS, workers=2, **options)


@cache
def good() -> Recalibration:
    return fitted(frame_of(PLAN, beads(PLAN, 1), 1))


def made_up() -> Recalibration:
    """Return a result that no fit has found."""
    return Recalibration(described(PLAN), PLAN, {}, {"beads 1": Goodness(1.0, 3000.0)}, Contents(PLAN.depths_um))


def shot_noise(light: np.ndarray, seed: int) -> NewFrame:
    """Return a frame with the noise of photons on an even dark field."""
    mean = 3000 * light / light.max() + 20
    return NewFrame(np.random.default_rng(seed).poisson(mean).astype(np.float32), noise=(1e-3, 1.0))


def error_of_h(setup: object, plan: ScanPlan = PLAN) -> float:
    """Return the relative L1 error of H over the window."""
    own = the_window(plan).plan
    found, true = patterns_at(setup, own, every_voxel(own), Fineness.fine, 2), true_patterns(plan)
    return float(np.abs(found.values - true.values).sum() / true.values.sum())


@pytest.mark.long
def test_one_frame_of_beads_recalibrates_the_camera() -> None:
    before, after = error_of_h(described(PLAN)), error_of_h(good().setup)
    assert good().accepted and good().worst == pytest.approx(1, abs=0.04)
    assert before > 0.1 and after < 0.01, (before, after)
    start = {name: one.start for name, one in good().parameters.items()}
    for name, one in good().parameters.items():
        assert abs(one.value - start[name] - WRONG.get(name, 0)) < 4 * one.sigma, name


@pytest.mark.long
def test_the_scale_of_the_depths_is_not_determined() -> None:
    """If the planes are 2 % farther than assumed, gap, focal lengths and iris change as much, and H hardly."""
    groups, scale = (*GROUPS, "focal_lengths"), 0.02
    camera = true_setup(PLAN).camera
    lever = [v * camera.lattice.gap_um * (1 + scale) for v in map(camera.virtual_depth, PLAN.depths_um)]
    farther = replace(PLAN, depths_um=tuple(camera.depth_of(a / camera.lattice.gap_um) for a in lever))
    own = replace(the_window(PLAN).plan, depths_um=farther.depths_um)
    patterns = patterns_at(true_setup(PLAN), own, every_voxel(own), Fineness.fine, 2)
    frame = shot_noise(patterns.images(beads(PLAN, 1)[None])[0], 1)
    known, found = (recalibrate([frame], plan, unknowns=groups, workers=2) for plan in (farther, PLAN))
    assert found.accepted and known.accepted
    assert set(found.depth_scale) >= {"gap_um", "f_number"}
    for name, share in found.depth_scale.items():
        new, old = known.parameters[name], found.parameters[name]
        assert share == pytest.approx(1, abs=0.4), name
        assert new.value / old.value - 1 == pytest.approx(scale * share, abs=5 * old.sigma / new.value)
    made = patterns_at(found.setup, the_window(PLAN).plan, every_voxel(own), Fineness.fine, 2).values
    assert np.abs(made - patterns.values).sum() < 0.02 * patterns.values.sum()
    assert any(words.startswith("scale of the depths") and "gap_um by" in words for words in found.notes)


@pytest.mark.long
def test_free_depths_are_not_followed_where_the_frames_do_not_determine_them() -> None:
    groups = (*GROUPS, "focal_lengths", "distance")
    found = recalibrate([frame_of(PLAN, beads(PLAN, 1), 1)], PLAN, unknowns=groups, workers=2)
    assert found.accepted and error_of_h(found.setup) < 0.02
    distance = found.parameters["distance_um"]
    assert 0 < distance.sigma_held < 0.5 * distance.sigma, "the distance changes H"


def test_combinations_that_are_not_determined_are_named() -> None:
    found = replace(made_up(), undetermined=(("gap_um", "distance_um"), ("rotation_rad",)))
    assert "these frames do not determine a common change of gap_um, distance_um" in found.notes[0]
    assert found.notes[1].startswith("these frames do not determine rotation_rad")


@pytest.mark.long
def test_frames_add_as_independent_information() -> None:
    two = fitted(*(frame_of(PLAN, beads(PLAN, seed), seed) for seed in (1, 2)))
    assert two.accepted and sorted(two.goodness) == ["beads 1", "beads 2"]
    assert two.verdict.startswith("recalibrated from 2 frames")
    held = [two.parameters[name].sigma_held / one.sigma_held for name, one in good().parameters.items()]
    assert np.median(held) == pytest.approx(1 / np.sqrt(2), abs=0.12)


@pytest.mark.long
def test_objects_between_the_planes_are_noticed_and_remedied() -> None:
    own = the_window(PLAN).plan
    between = replace(own, depths_um=(PLAN.camera.depth_of(2.45), PLAN.camera.depth_of(2.95)))
    patterns = patterns_at(true_setup(PLAN), between, every_voxel(between), Fineness.fine, 2)
    found = fitted(shot_noise(patterns.images(beads(PLAN, 3)[None])[0], 0))
    assert any("planes" in words for words in found.remedies), found.remedies
    assert len(found.contents.depths_um) == 5
    assert found.accepted and error_of_h(found.setup) < 0.03


@pytest.mark.long
def test_a_wave_in_the_dark_field_is_noticed_and_remedied() -> None:
    plan = small_plan(side=76)  # a smaller frame has too few pixels for such a dark field
    frame = frame_of(plan, beads(plan, 1, 25), 1)
    y, x = np.mgrid[-1:1:76j, -1:1:76j]
    wave = np.random.default_rng(2).poisson(60 + 40 * np.sin(2 * np.pi * (x + 0.5 * y)))
    found = recalibrate([replace(frame, values=(frame.values + wave).astype(np.float32))], plan, unknowns=GROUPS)
    (words,) = found.remedies
    assert words == "a dark field with structure; the fit was repeated with a smooth dark field of 8 x 8 parts"
    assert found.accepted and found.contents.dark_parts == 8, found.verdict
    assert error_of_h(found.setup, plan) < 0.015


@pytest.mark.long
def test_light_that_no_object_explains_is_refused() -> None:
    frame = frame_of(PLAN, beads(PLAN, 1), 1)
    stripes = 300 * (np.arange(frame.values.shape[1]) % 2)
    found = fitted(replace(frame, values=(frame.values + stripes).astype(np.float32)))
    assert not found.accepted and found.verdict.startswith("not recalibrated: the goodness of fit is")
    assert found.remedies


def test_results_that_cannot_be_trusted_are_not_accepted() -> None:
    for goodness, words in (
        (Goodness(1.2, 4000), "the goodness of fit is 1.20, but at most 1.05 is allowed"),
        (Goodness(0.5, 4000), "the residual is only 0.50 times as large as the stated noise"),
        (Goodness(1.0, 300), "too few pixels are valid"),
    ):
        found = replace(made_up(), goodness={"frame": goodness})
        assert not found.accepted and found.verdict == f"not recalibrated: {words}"


@pytest.mark.long
def test_saturated_pixels_are_left_out_and_named() -> None:
    frame = frame_of(PLAN, beads(PLAN, 1), 1)
    clipped = replace(frame, values=np.minimum(frame.values, 800).astype(np.float32))
    notes: list[str] = []
    with notes_to(notes.append):
        found = fitted(clipped)
    assert any("left out as saturated" in one for one in notes)
    assert found.accepted and error_of_h(found.setup) < 0.015


def test_saturated_pixels_are_not_valid() -> None:
    frame, notes = frame_of(PLAN, beads(PLAN, 1), 1), list[str]()
    clipped = replace(frame, values=np.minimum(frame.values, 800).astype(np.float32))
    with notes_to(notes.append):
        found = MODULE.whole_frame(clipped, "beads.tif", PLAN, None)
    assert any("left out as saturated" in one for one in notes)
    assert not found.valid[clipped.values == 800].any() and found.valid[clipped.values < 800].all()


def test_frames_that_cannot_be_used_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ones, noise = np.ones((80, 60), np.float32), np.random.default_rng(0).poisson(200, (60, 60))
    noise = (noise + 3 * np.random.default_rng(1).standard_normal((60, 60))).astype(np.float32)
    for frame, message in (
        (NewFrame(ones[:60], label="a.tif"), r"a.tif, noise: .* got none; give the constant"),
        (NewFrame(ones[:60], noise=(9, 0)), r"got the variance 9 \+ 0 x value"),
        (NewFrame(ones, noise=(9, 1)), "got 80 x 60 px from row 0, column 0"),
        (NewFrame(ones[:50, :50], noise=(9, 1)), "expected 60 x 60 px, as in the camera"),
        (NewFrame(ones[:60], np.zeros((60, 60), bool), noise=(9, 1)), "valid pixels in a window"),
        (NewFrame(noise, noise=(9.0, 1.0)), r"objects: expected structure .* differ by (0.9|1.0)\d times the noise"),
    ):
        with pytest.raises(InputError, match=message):
            fitted(frame)
    frame = frame_of(PLAN, beads(PLAN, 1), 1)
    with pytest.raises(InputError, match="lens_centres"):
        recalibrate([frame], PLAN, unknowns=("lens_centres",))
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=[0.0], cutout=21)
    with pytest.raises(NoLatticeError, match="recalibration on frames"):
        recalibrate([frame], plan)
    monkeypatch.setattr(MODULE, "free_memory", lambda: 1_000_000)
    with pytest.raises(
        InputError, match=r"memory for the patterns of a window: expected at least .* got 800.0 kB that"
    ):
        fitted(frame)


def test_frames_with_one_label_get_different_labels() -> None:
    assert distinct_label("a.tif", ["b.tif"]) == "a.tif"
    assert distinct_label("a.tif", ["a.tif", "b.tif", "a.tif (2)"]) == "a.tif (3)"


def test_windows_become_smaller_if_memory_is_short(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan(side=900)
    full, least = 4 * 2 * 120**2 * 21**2, 4 * 2 * 60**2 * 21**2
    for free, copies, every, count, side in (
        (0, 1.25, False, 5, 140),  # unknown
        (1.25 * full / 0.8, 1.25, False, 5, 140),
        (0.6 * full / 0.8, 1.0, False, 5, 110),
        (least / 0.8, 1.0, False, 5, 80),
        (5 * full / 0.8, 1.0, True, 5, 140),
        (full / 0.8, 1.0, True, 1, 140),  # one large window instead of five
    ):
        monkeypatch.setattr(MODULE, "free_memory", lambda free=free: int(free) + 1 if free else 0)
        found = MODULE.windows_within(plan, None, copies, every=every)
        assert (len(found), found[0].shape) == (count, (side, side)), (free, every)
    monkeypatch.setattr(MODULE, "free_memory", lambda: least)
    with pytest.raises(InputError, match="memory for the patterns of a window"):
        MODULE.windows_within(plan, None, 1.0, every=False)


@pytest.mark.long
def test_a_stopped_fit_continues_from_its_steps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plan = small_plan(side=100)
    frame, notes = frame_of(plan, beads(plan, 8, 40), 8), list[str]()
    monkeypatch.setattr(FIT, "ROUNDS", ((8, Fineness.coarse, 0.9), (8, Fineness.coarse, 0.0)))
    monkeypatch.setattr(FIT, "_remedies", lambda plan: [])
    settings = {"unknowns": ("iris",), "windows": 2, "workers": 2}
    monkeypatch.setattr(WINDOW, "CORNERS", ((0.0, 0.0), (1.0, 1.0)))
    monkeypatch.setattr(MODULE, "SIDES", (40,))
    whole = recalibrate([frame], plan, **settings)
    work = iter_recalibrate([frame], plan, steps=tmp_path / "steps", **settings)
    with notes_to(notes.append):
        for _ in range(4):  # three windows of the first two rounds
            next(work)
    work.close()
    assert any("2 windows of 80 x 80 px, about " in one and "memory" in one for one in notes), notes
    assert sorted(one.name for one in (tmp_path / "steps").iterdir())[1:] == [f"step_{k:04d}.npz" for k in (1, 2, 3)]
    scored = FIT._Run._scored
    made: list[int] = []
    monkeypatch.setattr(FIT._Run, "_scored", lambda *given: made.append(1) or scored(*given))
    again = recalibrate([frame], plan, steps=tmp_path / "steps", **settings)
    assert len(made) == 1 and again.goodness == whole.goodness
    assert {name: one.value for name, one in again.parameters.items()} == {
        name: one.value for name, one in whole.parameters.items()
    }
    with pytest.raises(InputError, match="stored steps: expected those of a fit with the same frames and settings"):
        recalibrate([replace(frame, values=frame.values + 1)], plan, steps=tmp_path / "steps", **settings)


def test_damaged_steps_are_computed_again(tmp_path: Path) -> None:
    values, made = {"a": np.arange(200.0)}, list[int]()

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return values

    def of_first_step() -> np.ndarray:
        return Steps(tmp_path, "key", {"windows": [1]}).result(make)["a"]

    assert np.array_equal(of_first_step(), of_first_step()) and len(made) == 1
    file, notes = tmp_path / "step_0001.npz", list[str]()
    whole = file.read_bytes()
    for n, damaged in enumerate((b"", whole[:100], whole[: len(whole) // 2], b"PK" + whole[50:], b"text")):
        file.write_bytes(damaged)
        with notes_to(notes.append):
            assert np.array_equal(of_first_step(), values["a"]), n
        assert len(made) == n + 2 and "computed again" in notes[-1] and file.read_bytes() == whole
    for text in ("", "{", "[]", "{}", '{"key": "key"}', '{"key": "key", "settings": 3}'):
        (tmp_path / "fit.json").write_text(text)
        with pytest.raises(InputError, match=r"got a damaged file fit\.json; repeat the same command, or start again"):
            Steps(tmp_path, "key", {})


def test_more_planes_end_at_infinity() -> None:
    """A plane half a step beyond infinity ended a fit that was complete."""
    camera, optics = PLAN.camera, PLAN.camera.optics
    infinity = (optics.focal_length_um - optics.image_distance_um) / camera.lattice.gap_um
    plan = ScanPlan.for_camera(camera, virtual_depths=[infinity + 0.2, infinity + 0.7], cutout=21)
    found = [camera.virtual_depth(z) - infinity for z in FIT._closer(plan)]
    assert sorted(found) == pytest.approx([0.2, 0.45, 0.7, 0.95])


def test_sigmas_include_the_error_of_the_grid_of_voxels(monkeypatch: pytest.MonkeyPatch) -> None:
    vector = Vector(described(PLAN), ScanScales.of(the_window(PLAN).plan), GROUPS)
    run, n = FIT._Run([], PLAN, vector, Steps(None, "", {}), 1), len(vector)

    def fit(contents: Contents, stage: str) -> Work[object]:
        ratio = 1.0 if contents.halves else 1.2
        yield from ()
        u = np.full(n, float(contents.halves))
        return FIT._At(u, 1e4 * np.eye(n + 1), {"beads": Goodness(ratio, 1e4)}, contents, np.zeros(n))

    monkeypatch.setattr(run, "_iter_fit", fit)
    found = run._summary(*drain(run._iter_remedied(drain(fit(Contents(PLAN.depths_um), "")))))
    assert found.accepted and found.contents.halves and "voxels of half a pixel" in found.remedies[0]
    scales = {one.name: one.scale for one in vector.unknowns}
    for name, one in found.parameters.items():  # the fits with whole and half voxels differ by one scale
        assert scales[name] <= one.sigma < 1.1 * scales[name], name


@pytest.mark.long
@pytest.mark.parametrize("seed", [31, 32])
def test_points_between_the_voxels_have_errors_as_stated(seed: int) -> None:
    rng, count, own = np.random.default_rng(seed), 15, the_window(PLAN).plan
    ny, nx = own.period
    places = np.stack([rng.integers(low, high, count) for low, high in ((0, 2), (3, ny - 3), (3, nx - 3))], axis=1)
    points = patterns_at(true_setup(PLAN), own, (places, rng.uniform(-0.5, 0.5, (count, 2))), Fineness.finest, 1)
    light = points.images(rng.uniform(0.3, 1, (1, count)).astype(np.float32))[0]
    found = fitted(shot_noise(light, seed))
    pulls = [(one.value - one.start - WRONG.get(name, 0)) / one.sigma for name, one in found.parameters.items()]
    print(seed, found.verdict, found.remedies, pulls)
    assert not found.accepted or np.sqrt(np.mean(np.square(pulls))) < 1.5, pulls
