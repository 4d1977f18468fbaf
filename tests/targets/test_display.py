"""A display as a target: points on its pixels, several offsets lit at once, and what each shows alone."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource, Noise, Samples
from lfcal.frames.view import SourceView
from lfcal.multiplex import s_matrix
from lfcal.targets import (
    DecodedFrames,
    Display,
    TargetCamera,
    TargetPlan,
    Wishes,
    coded_plan,
    decoded,
    display_image,
    iter_plan_display,
    parse_display,
)
from lfcal.targets.frames import TargetFrames, frames_of
from lfcal.targets.plan import lit_by
from lfcal.targets.subsets import group_order, subset_patterns
from tests.targets.common import scan_of, small

SCAN = scan_of(small(200))
DISPLAY = Display((2000, 2000), 5.0)
CODE = s_matrix(3)


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    return drain(iter_plan_display(SCAN, DISPLAY, Wishes(0.3, 0.02, 3)))


@pytest.fixture(scope="module")
def coded(plan: TargetPlan) -> TargetPlan:
    return coded_plan(plan, CODE, DISPLAY.pixel_um)


def test_displays_in_words() -> None:
    assert parse_display("display:2160x3840@8um") == Display((2160, 3840), 8.0)
    assert parse_display("display:20x30@0.05mm") == Display((20, 30), 50.0)
    assert parse_display("array:6x6@1mm") is None
    for wrong in ("display", "display:20x30", "display:20@5um", "display:20x30@um", "display:1x30@5um"):
        with pytest.raises(InputError):
            parse_display(wrong)


def test_points_and_offsets_are_whole_pixels_of_the_display(plan: TargetPlan) -> None:
    pixel = DISPLAY.pixel_um
    whole = np.concatenate([np.array(plan.target.pitch_um) / pixel, (plan.offsets_um(0) / pixel).ravel()])
    np.testing.assert_allclose(whole, np.round(whole), atol=1e-6)
    assert plan.lit is None and plan.target.hole_um == pytest.approx(pixel * 2 / np.sqrt(3))


def test_all_phases_are_shown_if_the_pixels_are_small_enough() -> None:
    found = drain(iter_plan_display(SCAN, DISPLAY, Wishes(0.25, 0.02)))
    assert found.coverage(0) == 1.0
    coarse = drain(iter_plan_display(SCAN, Display((200, 200), 70.0), Wishes(0.25, 0.02)))
    assert 0 < coarse.coverage(0) < 1.0


def test_no_plan_without_room() -> None:
    with pytest.raises(InputError, match="room for two points"):
        drain(iter_plan_display(SCAN, Display((60, 60), 5.0)))
    # as high as two periods and a pixel: one row has room to move, a second has not
    period, step = SCAN.camera.period_px[0], SCAN.camera.step_um(SCAN.depths_um[0])
    rows = math.ceil(2 * period * step / DISPLAY.pixel_um) + 1
    found = drain(iter_plan_display(SCAN, replace(DISPLAY, shape=(rows, 2000)), Wishes(0.3, 0.02, 3)))
    assert found.target.shape[0] == 1 < found.target.shape[1]
    with pytest.raises(InputError, match="room for two points"):
        drain(iter_plan_display(SCAN, replace(DISPLAY, shape=(rows - 1, 2000)), Wishes(0.3, 0.02, 3)))


def test_the_image_on_a_display(plan: TargetPlan, coded: TargetPlan) -> None:
    one, count = [display_image(plan, DISPLAY, 0, k) for k in range(3)], len(plan.target.holes)
    assert all(int((image > 0).sum()) == count for image in one)
    # down and to the right, as the camera sees it
    moved = np.argwhere(one[1])[0] - np.argwhere(one[0])[0]
    assert moved.tolist() == np.rint((plan.offsets_um(0)[1] - plan.offsets_um(0)[0])[::-1] / 5.0).astype(int).tolist()
    for k, lit in enumerate(coded.lit[0]):
        assert np.array_equal(display_image(coded, DISPLAY, 0, k), np.maximum.reduce([one[m] for m in lit]))
    with pytest.raises(InputError, match="outside it"):
        display_image(plan, Display((100, 100), 5.0), 0, 0)


def test_points_may_be_at_the_edge_of_the_display(plan: TargetPlan) -> None:
    touched = set()
    large = [replace(DISPLAY, shape=(side, side)) for side in (1999, 2000)]
    for display, k in itertools.product(large, range(len(plan.offsets_px[0]))):
        whole = display_image(plan, display, 0, k)
        rows, columns = np.nonzero(whole)
        room = [min(at.min(), n - 1 - at.max()) for at, n in zip((rows, columns), whole.shape, strict=True)]
        tight = Display((whole.shape[0] - 2 * room[0], whole.shape[1] - 2 * room[1]), DISPLAY.pixel_um)
        inner = whole[room[0] : room[0] + tight.shape[0], room[1] : room[1] + tight.shape[1]]
        assert np.array_equal(display_image(plan, tight, 0, k), inner)
        touched |= {side for side, line in enumerate((inner[0], inner[-1], inner[:, 0], inner[:, -1])) if line.any()}
        for less in ((2, 0), (0, 2)):
            small = replace(tight, shape=(tight.shape[0] - less[0], tight.shape[1] - less[1]))
            with pytest.raises(InputError, match="outside"):
                display_image(plan, small, 0, k)
    assert touched >= {0, 2}, "first rows and columns were met"


def test_groups_are_filled_up_by_repeats(plan: TargetPlan) -> None:
    four = replace(plan, offsets_px=((*plan.offsets_px[0], (0.0, 3.0)),))
    more = coded_plan(four, CODE, DISPLAY.pixel_um)
    assert len(more.frames) == 6 and more.lit[0][3:] == tuple(tuple(m + 3 for m in one) for one in more.lit[0][:3])
    # a period towards the middle, in whole pixels of the display: what is shown stays on it
    period = SCAN.camera.period_px[0]
    for (row, column), (again, other) in zip(more.offsets_px[0], more.offsets_px[0][4:], strict=False):
        unit = DISPLAY.pixel_um / SCAN.camera.step_um(SCAN.depths_um[0])
        assert column == other and again - row == pytest.approx(-period if row > 0 else period, abs=unit / 2 + 1e-9)
    up = coded_plan(replace(plan, offsets_px=(((5.0, 0.0), (0.0, 3.0)),)), CODE, DISPLAY.pixel_um)
    assert up.offsets_px[0][2][0] < 0
    with pytest.raises(InputError, match="at least 4 offsets in plane 0, got 3 offsets"):
        coded_plan(plan, s_matrix(7), DISPLAY.pixel_um)
    with pytest.raises(InputError, match="a multiple of 3, got 4"):
        lit_by(CODE, 4)


def test_a_coded_plan_is_a_file(coded: TargetPlan, plan: TargetPlan) -> None:
    assert TargetPlan.from_json(coded.to_json()) == coded
    assert "lit" not in plan.to_dict() and TargetPlan.from_json(plan.to_json()) == plan
    assert coded.lit_in(0, 1) == coded.lit[0][1] and plan.lit_in(0, 1) == (1,)


def test_codes_that_cannot_be_decoded_are_refused(plan: TargetPlan) -> None:
    for lit in (
        (((0, 1), (1, 2)),),
        (((0, 1), (1, 2), (0, 3)),),
        (((0, 1), (1, 1), (0, 2)),),
        (((0, 1), (), (0, 2)),),
        (((0, 1), (0, 1), (0, 2)),),
        ((), ()),
        "no",
        ((0, 1, 2),),
    ):
        with pytest.raises((InputError, FileFormatError)):
            replace(plan, lit=lit)
            pytest.fail(f"accepted {lit}")


class Noisy(SourceView):
    """Frames whose noise is known, one pixel of one of them not valid."""

    def samples(self, index: int, region: object = None) -> Samples:
        values = self.source.read(index, region)
        valid = np.ones(values.shape, np.bool_)
        valid[0, 0] = index != 1
        return Samples(values, valid, Noise(9.0, 0.5), 1)


def view_of(plan: TargetPlan, frames: np.ndarray) -> FrameSource:
    source = ArraySource(frames, [(0, 0, k) for k in range(len(frames))])
    return corrected_view(TargetFrames(source, plan), CorrectionRecipe(black_level=64.0), plan.scan)


def test_decoded_frames_are_those_of_single_offsets_with_their_noise(plan: TargetPlan, coded: TargetPlan) -> None:
    rng = np.random.default_rng(0)
    alone = rng.uniform(0, 100, (3, 200, 200)).astype(np.float32)
    sums = np.stack([sum(alone[m] for m in lit) for lit in coded.lit[0]]).astype(np.float32)
    source = Noisy(ArraySource(sums, [(0, 0, k) for k in range(3)]))
    found = DecodedFrames(source, coded)
    region = (slice(0, 40), slice(10, 60))
    for m in range(3):
        assert np.allclose(found.read(m, region), alone[m][region], atol=1e-3)
        seen = found.samples(m)
        assert np.allclose(seen.values, alone[m], atol=1e-3)
        assert not seen.valid[0, 0] and seen.valid.sum() == seen.valid.size - 1 and seen.saturated == 3
        # of order 3: 4n/(n + 1)² of the additive variance, 2/(n + 1) of the photons' of all at a pixel
        wanted = 12 / 16 * 9.0 + 0.5 * 2 / 4 * alone.sum(0)
        np.testing.assert_allclose(seen.noise.variance(seen.values), wanted, rtol=1e-4)
        assert "3 frames" in found.info(m).label
    assert decoded(source, plan) is source and isinstance(decoded(source, coded), DecodedFrames)
    with pytest.raises(InputError, match="coded frames"):
        DecodedFrames(source, plan)


def test_coded_frames_are_not_taken_for_single_ones(plan: TargetPlan, coded: TargetPlan) -> None:
    view = view_of(coded, np.zeros((3, 200, 200), np.uint16))
    with pytest.raises(InputError, match="sums of several offsets"):
        frames_of(view, coded)
    assert len(frames_of(decoded(view, coded), coded)) == 3
    source = ArraySource(np.zeros((len(plan.frames), 400, 400)), [(0, 0, k) for k in range(len(plan.frames))])
    with pytest.raises(InputError, match=r"expected 200 x 200 px, .* got 400 x 400 px; .*, or use the plan with which"):
        TargetFrames(source, plan)


@pytest.mark.long
def test_simulated_frames_show_what_is_lit(plan: TargetPlan, coded: TargetPlan) -> None:
    alone, sums = (TargetCamera(one, (), level="geometric") for one in (plan, coded))
    lights = alone.iter_lights(workers=1)
    single = drain(lights)
    np.testing.assert_allclose(sums.light(1), sum(single[m] for m in coded.lit[0][1]), rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(drain(sums.iter_lights([1], workers=1))[0], sums.light(1), rtol=1e-4, atol=1e-3)


def test_patterns_of_subsets_are_at_their_places(plan: TargetPlan) -> None:
    found = subset_patterns(plan, 0, 3)
    # of one cutout each, into which neighbours may reach
    assert found.shape == (3, 31, 31) and (np.isfinite(found).sum((1, 2)) == 31 * 31).all()
    assert len({int(np.nanargmax(one)) for one in found}) == 3, "each elsewhere"


def test_the_order_of_the_code_by_number_of_frames() -> None:
    for frames, order in ((1, 0), (2, 0), (3, 3), (6, 3), (7, 7), (9, 7), (11, 11), (200, 11)):
        assert group_order(frames) == order
