"""An H that its stated camera does not explain is never good, and the explanation is named with figures."""

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
from lfcal.camera import Camera
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import Setup, described_effects
from lfcal.judge import Evidence, Inspection, inspection, iter_evidence, iter_inspection
from lfcal.judge.expected import Behind, behind
from lfcal.judge.explained import EXPLAINED, iter_explained, iter_rearranged
from lfcal.judge.inspection import FAIR
from lfcal.judge.quality import inspect
from lfcal.psf import PSFMatrix
from lfcal.simulate.effects import MechanicalVignetting
from lfcal.simulate.effects.outlook import Outlook
from tests.judge.common import FEWEST, PEAK, Values, added, clean, noisy, plan, sensor

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


def inspected(H: PSFMatrix, seconds: float = 600.0) -> Inspection:
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
    found = inspected(one_plane(change(clean()[1:])))
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
    found = inspected(one_plane(blob(clean()[1:])))
    assert found.merit == "bad" and "little in common" in found.verdict
    assert "Check that this is the right camera" in found.verdict
    assert "orientation of frames" not in found.verdict.lower()


@LONG
def test_a_pupil_that_is_blocked_in_a_part_is_never_good() -> None:
    values = recorded_by(plan().camera, Blocked(radius=3.0))
    found = inspected(one_plane(values))
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


@pytest.mark.parametrize(
    "case", ["small gap", *(pytest.param(one, marks=LONG) for one in ("types", "gap", "iris", "turned"))]
)
def test_another_camera_than_described_is_never_good(case: str) -> None:
    camera, words = cameras()[case]
    found = inspected(one_plane(recorded_by(camera)))
    assert found.merit in ("bad", "unknown") and words in found.verdict, found.verdict
    assert not found.verdict.startswith("This H is good") and found.disagreement is not None


def test_orientation_is_known_where_the_camera_confirms_it() -> None:
    H = one_plane(clean()[1:])
    quality = inspect(H, workers=1)
    assert quality["scan_order"].merit == "unknown" and quality["scan_order"].applies
    assert inspected(H).quality["scan_order"].merit == "good"


def test_the_verdict_does_not_depend_on_how_fast_the_machine_is(monkeypatch: pytest.MonkeyPatch) -> None:
    before = inspected(one_plane(clean()[1:]))
    ticks = itertools.count(step=3.0)
    monkeypatch.setattr(time, "perf_counter", lambda: next(ticks))  # every look at the clock takes three seconds
    slow = inspected(one_plane(clean()[1:]), seconds=1e6)
    assert slow.seconds > 10 and slow.verdict == before.verdict
    assert timeless(slow) == timeless(before)


def timeless(found: Inspection) -> object:
    """Return everything that was found but for the time that it took."""
    return plain(replace(found, quality=replace(found.quality, seconds=0), seconds=0).to_dict())


def test_a_comparison_that_is_not_finished_is_never_good() -> None:
    found = inspected(one_plane(clean()[1:]), 1e-9)
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
    found = inspected(one_plane(values))
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


@pytest.mark.parametrize("origin", [(12, 9), pytest.param((0, 16), marks=LONG), pytest.param((8, -11), marks=LONG)])
def test_frames_that_are_a_part_of_the_sensor_are_named_with_their_place(origin: tuple[int, int]) -> None:
    rows, columns = plan().cutout
    first = [20 + n for n in origin]
    values = whole_frames()[..., first[0] : first[0] + rows, first[1] : first[1] + columns]
    found = inspected(one_plane(values))
    row, column = origin
    assert found.merit == "bad" and found.disagreement is not None and found.disagreement.explanation is not None
    assert found.disagreement.explanation.after < EXPLAINED
    if column < 0:
        assert "8 px down and 11 px left" in found.verdict and "anchor" in found.verdict
    else:
        assert f"begins at row {row}, column {column}" in found.verdict and f"--origin {row},{column}" in found.verdict
