"""What an inspection reports of an H as a whole: faults, metrics, and what it cannot know."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import plain
from lfcal.base.progress import drain
from lfcal.camera import Camera, preset
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import Setup, described_effects
from lfcal.judge import Evidence, Inspection, inspection, iter_evidence, iter_inspection
from lfcal.judge._scatter import misfit, variance_of
from lfcal.judge.expected import Behind, behind
from lfcal.judge.explained import EXPLAINED, iter_explained, iter_rearranged
from lfcal.judge.inspection import FAIR
from lfcal.judge.quality import inspect
from lfcal.psf import PSFMatrix
from lfcal.simulate.effects import MechanicalVignetting
from lfcal.simulate.effects.outlook import Outlook
from tests.judge import common
from tests.judge.common import FEWEST, PEAK, Values, added, clean, inspected, matrix, noisy, plan, sensor


def test_a_clean_recording_is_good() -> None:
    found = inspected(matrix(clean()))
    assert found.compared == common.PATTERNS and not found.faults and not found.bad
    assert found.verdict.startswith("This H is usable, but should be checked: light at the edge. "), "a small cutout"
    assert "show no fault" in found.verdict and "Assemble again with a larger cutout" in found.verdict


@pytest.mark.long
def test_a_fault_explains_the_metrics_that_it_looks_like() -> None:
    image = sensor(0.0)
    image[:, 25] = 60.0
    found = inspected(matrix(added(clean(), image)), FEWEST)
    assert found.bad and found.faults[0].name == "hot_line"
    assert found.verdict.startswith("This H should not be used as it is: hot line of the sensor")
    step = found.quality["stage_gain"]
    assert found.settled(step) is found.faults[0] and step not in found.alarms
    assert found.quality.redo() and not found.redo(), "no frame is recorded again for a line of the sensor"
    model = found.to_dict()["model"]
    assert model["faults"][0]["name"] == "hot_line" and np.isfinite(model["faults"][0]["share"])


def test_an_h_that_cannot_be_compared_is_judged_by_metrics_with_the_reason() -> None:
    found = inspected(PSFMatrix(clean()))
    assert not found.compared and found.why_not == "H has no camera"
    assert found.merit == found.quality.merit and "it was not compared with a camera (H has no camera)" in found.verdict
    patterns = np.random.default_rng(0).uniform(1, 2, (4, 1, 1, 21, 21)).astype(np.float32)
    flat = PSFMatrix(patterns, depths=(-1.0, 0.0, 1.0, 2.0), camera=preset("flfm_20x05"), anchor=(500.0, 500.0))
    H, known = matrix(clean()), {"depths": plan().depths_um, "camera": plan().camera}
    scaled = {"cutout": {"scale": [0.99, 0.99]}}
    for other, reason in (
        (flat, "only cameras with a lenslet lattice can be compared; lfcal fit compares this one"),
        (PSFMatrix(clean(), **known, anchor=(0.0, 0.0)), "cutout of position"),
        (PSFMatrix(H[:], **known, anchor=H.anchor, provenance=scaled), "resampled pixels"),
    ):
        unlike = drain(iter_evidence(other))
        assert not isinstance(unlike, Evidence) and reason in unlike.reason


@pytest.mark.long
def test_a_camera_that_does_not_explain_the_patterns_names_no_fault() -> None:
    camera = plan().camera
    lattice = replace(camera.lattice, gap_um=1.06 * camera.lattice.gap_um)
    other = PSFMatrix(clean(), depths=plan().depths_um, camera=replace(camera, lattice=lattice), anchor=plan().anchor)
    found = inspected(other, FEWEST)
    assert not found.faults and not found.compared and found.merit != "good" and "lfcal fit" in found.verdict
    assert "the gap between lenslets and sensor differs from the description by about -5.7 %" in found.verdict


def test_patterns_derived_from_others_are_not_compared() -> None:
    H = matrix(clean())
    derived = {"half_cell": {"positions": [[0, H.shape[1] * H.shape[2]]]}}  # all of plane 0
    other = PSFMatrix(H[:], depths=H.depths, camera=H.camera, anchor=H.anchor, provenance=derived)
    found = drain(iter_evidence(other, patterns=FEWEST))
    assert isinstance(found, Evidence) and set(found.index[:, 0].tolist()) == {1}


@pytest.mark.parametrize(
    "scale", [0.0, 1e-12, pytest.param(-1.0, marks=pytest.mark.long), pytest.param(1e11, marks=pytest.mark.long)]
)
def test_any_light_or_none_ends_in_words(scale: float) -> None:
    """Warnings are errors in tests: nothing is divided by no light."""
    found = inspected(matrix((scale * clean()).astype(np.float32)))
    if scale > 0:
        assert found.compared and not found.faults
    else:
        assert "no light" in found.why_not or "little in common" in found.why_not


def test_values_whose_squares_overflow_end_in_words() -> None:
    """Warnings are errors in tests: float32 holds no variance of these."""
    noise = np.random.default_rng(0).standard_normal(clean().shape)
    for size in (1e30, 1e-30):
        found = inspected(matrix((size * noise).astype(np.float32)))
        assert not found.compared and "where 1e-12 to 1e+15 is expected" in found.why_not, size


# -- the share of the light that a camera leaves unexplained ---------------------------------------------
LIGHT = np.full((6, 5, 5), 100.0, np.float32)
SEEN = np.ones(LIGHT.shape, np.bool_)
NOISE = np.ones_like(LIGHT)


def test_the_misfit_is_that_of_the_valid_patterns_without_noise() -> None:
    left, valid = 0.2 * LIGHT, SEEN.copy()
    valid[:4] = False
    assert misfit(left, LIGHT, valid, 0 * NOISE) == pytest.approx(0.2)
    assert misfit(left, LIGHT, ~SEEN, NOISE) == 0.0
    assert misfit(1e3 * LIGHT, 0 * LIGHT, SEEN, NOISE) == 1.0, "without expected light nothing is explained"
    noise = np.random.default_rng(0).standard_normal(LIGHT.shape).astype(np.float32)
    assert misfit(noise, LIGHT, SEEN, NOISE) < 0.01


def test_noise_of_photons_is_no_misfit_and_errors_of_the_model_are_no_noise() -> None:
    """Noise that grows with the light, and an error of the model of 10 % of the light that grows faster."""
    rng = np.random.default_rng(3)
    light = (1000 * rng.random((20, 40, 40)) ** 4).astype(np.float32)
    seen = np.ones(light.shape, np.bool_)
    photons = (np.sqrt(4 + 2 * light) * rng.standard_normal(light.shape)).astype(np.float32)
    wrong = (0.1 * light * np.where(rng.random(light.shape) < 0.5, -1, 1)).astype(np.float32)
    for left, least, most in ((photons, 0.0, 0.03), (photons + wrong, 0.09, 0.11)):
        _, constant, slope = variance_of(left, light, seen)
        assert slope == pytest.approx(2, rel=0.25)
        assert least <= misfit(left, light, seen, constant + np.float32(slope) * light) < most


# -- an H that its stated camera does not explain is never good, and the explanation has figures ---------
Change = Callable[[Values], Values]


class Blocked(MechanicalVignetting):
    """A straight stop that covers all pupil beyond 0.5 radii to the right: 23 % of the light of seven blades."""

    def shift(self, outlook: Outlook) -> tuple[float, float]:
        del outlook
        return 0.0, 0.5 - self.radius


def one_plane(values: Values, camera: Camera | None = None) -> PSFMatrix:
    known = plan()
    return PSFMatrix(
        np.ascontiguousarray(values), depths=known.depths_um[1:], camera=camera or known.camera, anchor=known.anchor
    )


def examined(H: PSFMatrix, seconds: float = 600.0) -> Inspection:
    return drain(iter_inspection(H, inspect(H, workers=1), seconds=seconds, patterns=FEWEST))


def light_of(camera: Camera, index: NDArray[np.intp], *effects: MechanicalVignetting) -> Values:
    setup = Setup(camera, (*described_effects(camera), *effects), (0.0, 0.0))
    return predict(setup, plan(), index, np.zeros((len(index), 2)), Fineness.coarse)


def recorded_by(camera: Camera, *effects: MechanicalVignetting) -> Values:
    """Return plane 1 of the scan as another camera records it, computed without inspection's code."""
    known = plan()
    index = np.argwhere(np.ones((1, *known.period), np.bool_)) + np.array([1, 0, 0])
    light = light_of(camera, index, *effects)
    light = light.reshape(1, *known.period, *known.cutout)
    return noisy((light * (PEAK / light.max())).astype(np.float32))


def lines_displaced(values: Values) -> Values:
    out = values.copy()
    out[..., 1::2, :] = np.roll(values[..., 1::2, :], 1, -1)
    return out


def blob(values: Values) -> Values:
    t, s = (np.arange(n) - (n - 1) / 2 for n in values.shape[3:])
    spot = PEAK * np.exp(-(t[:, None] ** 2 + s**2) / (2 * 5.0**2))
    return noisy(np.broadcast_to(spot, values.shape).astype(np.float32))


CASES: dict[str, tuple[Change, str]] = {
    "mirrored": (lambda v: v[:, :, ::-1, :, ::-1], "mirrored left to right"),
    "rotated": (lambda v: v[:, ::-1, ::-1, ::-1, ::-1], "turned by 180°"),
    "patterns mirrored": (lambda v: v[..., ::-1, :], "mirrored top to bottom"),
    "patterns turned": (lambda v: np.rot90(v, axes=(3, 4)), "turned anticlockwise by 90°"),
    "transposed": (lambda v: v.swapaxes(3, 4), "transposed (rows and columns swapped)"),
    "interlaced": (lines_displaced, "every other row is displaced by 1 px along the rows"),
}


MORE = ("interlaced", "transposed", "rotated", "patterns mirrored", "patterns turned")
LONG = pytest.mark.long


@pytest.mark.parametrize("case", ["mirrored", *(pytest.param(one, marks=LONG) for one in MORE)])
def test_what_was_done_to_the_patterns_is_named_with_figures(case: str) -> None:
    change, words = CASES[case]
    found = examined(one_plane(change(clean()[1:])))
    assert found.merit == "bad" and found.bad and words in found.verdict
    assert "unexplained light: " in found.verdict
    assert found.quality["scan_order"].merit == "unknown", "the camera does not confirm the orientation"
    explanation = found.disagreement and found.disagreement.explanation
    assert explanation is not None and explanation.after < EXPLAINED < explanation.before
    assert not found.compared and not found.faults, "no fault is named where there is none"


def camera_of(H: PSFMatrix) -> Behind:
    known = behind(H, np.array([[0, 3, 3]]))
    assert known is not None
    return known


@LONG
def test_interlaced_rows_are_named_and_a_right_camera_needs_no_explanation() -> None:
    H = one_plane(lines_displaced(clean()[1:]))
    found = drain(iter_rearranged(H, camera_of(H)))
    assert found is not None and CASES["interlaced"][1] in found.words and found.after < EXPLAINED
    H = one_plane(clean()[1:])
    assert drain(iter_explained(H, camera_of(H))) is None


@pytest.mark.parametrize("searched", [False, pytest.param(True, marks=LONG)])
def test_an_h_without_lenslets_is_not_its_cameras(searched: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not searched:  # the whole search for an explanation is slow
        monkeypatch.setattr(inspection, "iter_rearranged", _none_explains)
        monkeypatch.setattr(inspection, "iter_explained", _none_explains)
    found = examined(one_plane(blob(clean()[1:])))
    assert found.merit == "bad" and "little in common" in found.verdict
    assert "Check that this is the right camera" in found.verdict
    assert "orientation of frames" not in found.verdict.lower()


@LONG
def test_a_pupil_that_is_blocked_in_a_part_is_never_good() -> None:
    values = recorded_by(plan().camera, Blocked(radius=3.0))
    found = examined(one_plane(values))
    assert found.merit == "bad" and "pupil" in found.verdict
    costs = [one.cost for one in found.faults if one.name == "pupil"]
    assert costs and costs[0] is not None and costs[0] > FAIR


def test_the_share_of_the_pupil_that_is_blocked_is_estimated() -> None:
    camera, stop = plan().camera, Blocked(radius=3.0)
    some = np.array([(1, y, x) for y in range(0, 19, 4) for x in range(0, 33, 5)])
    lost = 1 - light_of(camera, some, stop).sum() / light_of(camera, some).sum()
    H = one_plane(recorded_by(camera, stop))
    evidence = drain(iter_evidence(H, patterns=FEWEST))
    assert isinstance(evidence, Evidence)
    explanation = drain(iter_explained(H, evidence.camera, evidence=evidence))
    assert explanation is not None and explanation.kind == "pupil" and explanation.of_recording
    share = float(explanation.words.split()[1])
    assert share == pytest.approx(100 * lost, abs=6), (share, lost)


def _none_explains(*_: object, **__: object):  # type: ignore[no-untyped-def]
    yield from ()


def cameras() -> dict[str, tuple[Camera, str]]:
    camera = plan().camera
    lattice, optics = camera.lattice, camera.optics

    def other(**changes: object) -> Camera:
        return replace(camera, lattice=replace(lattice, **changes))

    types = (lattice.types[0], lattice.types[2], lattice.types[1])
    return {
        "types": (other(types=types), "lens types are in another order: 0, 2, 1"),
        "gap": (other(gap_um=0.94 * lattice.gap_um), "about -6"),
        "small gap": (other(gap_um=0.985 * lattice.gap_um), "about -1.5 %"),
        "iris": (replace(camera, optics=replace(optics, f_number=1.2 * optics.f_number)), "about -1"),
        "turned": (other(rotation_rad=math.radians(1.5)), "of the light unexpl"),
    }


@LONG
@pytest.mark.parametrize(
    "case", ["small gap", *(pytest.param(one, marks=LONG) for one in ("types", "gap", "iris", "turned"))]
)
def test_another_camera_than_described_is_never_good(case: str) -> None:
    camera, words = cameras()[case]
    found = examined(one_plane(recorded_by(camera)))
    assert found.merit in ("bad", "unknown") and words in found.verdict, found.verdict
    assert not found.verdict.startswith("This H is good") and found.disagreement is not None


def test_orientation_is_known_where_the_camera_confirms_it() -> None:
    H = one_plane(clean()[1:])
    quality = inspect(H, workers=1)
    assert quality["scan_order"].merit == "unknown" and quality["scan_order"].applies
    assert examined(H).quality["scan_order"].merit == "good"


def test_the_verdict_does_not_depend_on_how_fast_the_machine_is(monkeypatch: pytest.MonkeyPatch) -> None:
    before = examined(one_plane(clean()[1:]))
    ticks = itertools.count(step=3.0)
    monkeypatch.setattr(time, "perf_counter", lambda: next(ticks))  # every look at the clock takes three seconds
    slow = examined(one_plane(clean()[1:]), seconds=1e6)
    assert slow.seconds > 10 and slow.verdict == before.verdict
    assert timeless(slow) == timeless(before)


def timeless(found: Inspection) -> object:
    """Return everything that was found but for the time that it took."""
    return plain(replace(found, quality=replace(found.quality, seconds=0), seconds=0).to_dict())


def test_a_comparison_that_is_not_finished_is_never_good() -> None:
    found = examined(one_plane(clean()[1:]), 1e-9)
    assert found.merit == "unknown" and found.verdict.startswith("This H is not fully judged")
    assert "--seconds" in found.verdict and found.unfinished


def test_faults_found_before_the_time_limit_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    image = sensor(0.0)
    image[:, 25] = 15.0
    values = added(clean(), image)[1:]

    def never(*_: object):  # type: ignore[no-untyped-def]
        monkeypatch.setattr(inspection.time, "perf_counter", lambda: math.inf)
        yield
        raise AssertionError("the limit was reached")

    monkeypatch.setattr(inspection, "iter_costs", never)
    found = examined(one_plane(values))
    assert found.compared and found.faults and found.unfinished and found.merit in ("bad", "unknown")


@cache
def whole_frames() -> Values:
    """Return cutouts of plane 1 with twenty more pixels on each side."""
    known = plan()
    wider = replace(known, cutout=tuple(n + 40 for n in known.cutout))
    index = np.argwhere(np.ones((1, *known.period), np.bool_)) + np.array([1, 0, 0])
    setup = Setup(known.camera, described_effects(known.camera), (0.0, 0.0))
    light = predict(setup, wider, index, np.zeros((len(index), 2)), Fineness.coarse)
    return noisy((light * (PEAK / light.max())).reshape(1, *known.period, *wider.cutout).astype(np.float32))


@LONG
@pytest.mark.parametrize("origin", [(12, 9), pytest.param((0, 16), marks=LONG), pytest.param((8, -11), marks=LONG)])
def test_frames_that_are_a_part_of_the_sensor_are_named_with_their_place(origin: tuple[int, int]) -> None:
    rows, columns = plan().cutout
    first = [20 + n for n in origin]
    values = whole_frames()[..., first[0] : first[0] + rows, first[1] : first[1] + columns]
    found = examined(one_plane(values))
    row, column = origin
    assert found.merit == "bad" and found.disagreement is not None and found.disagreement.explanation is not None
    assert found.disagreement.explanation.after < EXPLAINED
    if column < 0:
        assert "8 px down and 11 px left" in found.verdict and "anchor" in found.verdict
    else:
        assert f"begins at row {row}, column {column}" in found.verdict and f"--origin {row},{column}" in found.verdict
