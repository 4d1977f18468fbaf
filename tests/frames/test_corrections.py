"""The correction chain against its definition in float64: order, regions, background, variance of its results."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import (
    ArraySource,
    Background,
    CorrectionChain,
    Dark,
    Defects,
    Exposure,
    FrameEntry,
    Position,
    White,
    average_frames,
    corrected,
)
from lfcal.frames.aligned import ShiftedSource
from lfcal.frames.corrections.steps import DarkSet, border_strips
from lfcal.frames.described import DescribedSource, sensor_noise, stated_noise
from lfcal.frames.source import Noise, observed
from tests.frames.photon_transfer.sensor_model import Truth, micro_images, vignetting
from tests.frames.scenes import session

SHAPE = (48, 60)
RNG = np.random.default_rng(7)
DARK = RNG.normal(100, 5, SHAPE)
WHITE = 5000 * np.hypot(*np.meshgrid(np.linspace(0.2, 1, 60), np.linspace(0.3, 1, 48))) + DARK
PIXELS = np.array([(0, 0), (10, 11), (10, 12), (11, 11), (47, 59), (20, 30), (22, 30)])


def frame(dtype: Any = np.uint16, seed: int = 3) -> np.ndarray:
    rows, columns = np.indices(SHAPE)
    values = np.random.default_rng(seed).integers(0, 4000, SHAPE) + 2 * rows + columns
    return values.astype(dtype)


def chain(cfa: str = "", kind: str = "constant", exposure_first: bool = False) -> CorrectionChain:
    ends = [Background(kind, 40.0 if kind == "constant" else 0.0, width=5), Exposure(0.1)]
    return CorrectionChain(
        (
            Dark(DARK, 12.5),
            White(WHITE, DARK, cfa=cfa),
            Defects(PIXELS, SHAPE, cfa),
            *(ends[::-1] if exposure_first else ends),
        )
    )


# -- the definition, step by step in float64 ------------------------------------------------------------------


def same_colour(cfa: str, a: tuple[int, int], b: tuple[int, int]) -> bool:
    side = {0: 1, 4: 2}[len(cfa)]
    at = [(r % side) * side + c % side for r, c in (a, b)]
    return not cfa or cfa[at[0]] == cfa[at[1]]


def repaired(values: np.ndarray, cfa: str) -> np.ndarray:
    bad = {(int(r), int(c)) for r, c in PIXELS}
    result = values.copy()
    for pixel in bad:
        near: dict[int, list[float]] = {}
        for dr, dc in np.ndindex(11, 11):
            r, c, distance = pixel[0] + dr - 5, pixel[1] + dc - 5, (dr - 5) ** 2 + (dc - 5) ** 2
            inside = 0 <= r < SHAPE[0] and 0 <= c < SHAPE[1]
            if inside and 0 < distance <= 32 and (r, c) not in bad and same_colour(cfa, pixel, (r, c)):
                near.setdefault(distance, []).append(values[r, c])
        result[pixel] = np.mean(near[min(near)])
    return result


def definition(raw: np.ndarray, cfa: str, kind: str, exposure_first: bool, exposure_s: float) -> np.ndarray:
    light = WHITE.astype(np.float32).astype(float) - DARK.astype(np.float32).astype(float)
    relative = np.empty(SHAPE)
    side = 2 if cfa else 1
    for r, c in np.ndindex(side, side):
        part = light[r::side, c::side]
        relative[r::side, c::side] = part / np.percentile(part, 99)
    value = (raw.astype(float) - DARK.astype(np.float32) - 12.5) / np.maximum(relative, 0.05)
    value = repaired(value, cfa)
    if exposure_first:
        value *= 0.1 / exposure_s
    border = np.ones(SHAPE, bool)
    border[5:-5, 5:-5] = False
    if kind == "constant":
        value -= 40
    elif kind == "border":
        value -= np.median(value[border])
    return value if exposure_first else value * (0.1 / exposure_s)


@pytest.mark.parametrize("exposure_first", [False, True])
@pytest.mark.parametrize("cfa", ["", "GRBG"])
def test_chain_is_its_definition(cfa: str, exposure_first: bool) -> None:
    for kind in ("constant", "border"):
        expected = definition(frame(), cfa, kind, exposure_first, 0.25)
        for dtype in (np.uint16, np.float32, np.float64):
            result = chain(cfa, kind, exposure_first).apply(frame(dtype), exposure_s=0.25)
            assert result.dtype == np.float32
            np.testing.assert_allclose(result, expected, rtol=0, atol=3e-6 * np.abs(expected).max())


def test_differences_stay_signed_and_an_empty_chain_makes_floats() -> None:
    raw = np.full(SHAPE, 90, np.uint16)
    result = CorrectionChain((Dark(np.full(SHAPE, 100.0)),)).apply(raw)
    np.testing.assert_array_equal(result, np.full(SHAPE, -10, np.float32))
    assert (raw - np.uint16(100)).max() == 65526, "what unsigned arithmetic would give"
    result = CorrectionChain().apply(frame())
    np.testing.assert_array_equal(result, frame().astype(np.float32))
    assert result.dtype == np.float32


def test_white_image_becomes_flat_and_dim_pixels_stay_finite() -> None:
    white = np.full(SHAPE, 2000.0)
    white[:, 30:] = 1000
    white[5, 6] = 0
    step = White(white, 0.0)
    flat = CorrectionChain((step,)).apply(white)
    np.testing.assert_allclose(np.delete(flat.ravel(), 5 * 60 + 6), 2000, rtol=1e-6)
    assert flat[5, 6] == 0 and np.argwhere(step.dim).tolist() == [[5, 6]]
    assert step.gain.max() == pytest.approx(20)
    assert step.describe()["dim_pixels"] == 1


def test_white_of_a_mosaic_keeps_the_ratio_of_colours() -> None:
    white = np.full(SHAPE, 1000.0)
    white[0::2, 1::2] = 3000  # red of GRBG
    flat = CorrectionChain((White(white, 0.0, cfa="GRBG"),)).apply(white)
    np.testing.assert_allclose(flat, white, rtol=1e-6)
    grey = CorrectionChain((White(white, 0.0),)).apply(white)
    np.testing.assert_allclose(grey, 3000, rtol=1e-6)


# -- properties ------------------------------------------------------------------------------------------------

slices = st.tuples(st.integers(0, 40), st.integers(1, 48), st.integers(0, 50), st.integers(1, 60))


@given(slices, st.sampled_from(["", "GRBG"]), st.sampled_from(["constant", "border", "plane"]), st.booleans())
@settings(derandomize=True, deadline=None, max_examples=40)
def test_region_is_the_crop_of_the_whole(part: tuple[int, int, int, int], cfa: str, kind: str, masked: bool) -> None:
    raw = frame(np.float32)
    if masked:
        raw[RNG.integers(0, 48, 40), RNG.integers(0, 60, 40)] = np.nan
    rows = slice(part[0], min(48, part[0] + part[1]))
    columns = slice(part[2], min(60, part[2] + part[3]))
    source = corrected(ArraySource(raw[None], [(0, 0, 0)], exposures_s=[0.2]), chain(cfa, kind))
    np.testing.assert_array_equal(source.read(0, (rows, columns)), source.read(0)[rows, columns])


@given(st.integers(0, 3), st.integers(1, 8))
@settings(derandomize=True, deadline=None, max_examples=12)
def test_threads_and_output_array_change_nothing(seed: int, workers: int) -> None:
    out = np.empty(SHAPE, np.float32)
    result = chain("GRBG", "plane").apply(frame(seed=seed), exposure_s=0.2, out=out, workers=workers)
    assert result is out
    np.testing.assert_array_equal(out, chain("GRBG", "plane").apply(frame(seed=seed), exposure_s=0.2))


# -- saturation ------------------------------------------------------------------------------------------------


def test_saturation_is_counted_before_correction() -> None:
    raw = frame()
    raw[3, 4:9] = 4095
    raw[10, 11] = 4095  # a known defect does not count
    raw[1, 1] = 5000
    raw = np.minimum(raw, 4095)
    source = corrected(ArraySource(raw[None], [(0, 0, 0)], exposures_s=[1.0], metadata={"saturation": 4095}), chain())
    expected = int((raw >= 4095).sum()) - 1
    assert source.samples(0).saturated == expected
    assert source.samples(0, (slice(3, 4), slice(6, 60))).saturated == int((raw[3, 6:] >= 4095).sum())
    assert source.samples(0, (slice(10, 11), slice(11, 12))).saturated == 0
    valid = source.samples(0).valid
    assert valid is not None and valid[10, 11] and not valid[3, 4:9].any()
    assert np.count_nonzero(~valid) == expected
    raised = corrected(ArraySource(raw[None], [(0, 0, 0)], exposures_s=[1.0]), CorrectionChain(saturation=4000))
    assert raised.samples(0).saturated == int((raw >= 4000).sum())


def test_samples_are_saturated_from_their_level_on() -> None:
    for dtype, level, value, count in (
        *((np.uint8, None, 255, 1), (np.uint8, None, 254, 0), (np.uint8, 4095, 255, 0)),
        *((np.uint16, None, 65535, 1), (np.uint16, None, 65534, None)),
        *((np.uint16, 4094.5, 4095, 1), (np.uint16, 4094.5, 4094, 0)),
        *((np.float32, None, 1e9, None), (np.float32, 1000.0, 1000.0, 1)),
    ):
        raw = np.zeros((3, 4), dtype)
        raw[1, 2] = value
        assert observed(raw, level).saturated == count, (dtype, level, value)


# -- order and errors ------------------------------------------------------------------------------------------

STEPS = {
    "Dark": Dark(level=10.0),
    "White": White(WHITE, 0.0),
    "Defects": Defects(PIXELS, SHAPE),
    "Background": Background("constant", 5.0),
    "Exposure": Exposure(0.1),
}


def test_wrong_order_says_what_to_exchange() -> None:
    pairs = "White Dark, Defects White, Background Dark, Exposure Defects, Background White"
    for first, second in (pair.split() for pair in pairs.split(", ")):
        CorrectionChain((STEPS[second], STEPS[first]))
        words = f"expected {second} before {first}, got {first} before {second}; exchange the two"
        with pytest.raises(InputError, match=words):
            CorrectionChain((STEPS[first], STEPS[second]))
    # the counter-test: another order gives another result
    dark, white = CorrectionChain((STEPS["Dark"],)), CorrectionChain((STEPS["White"],))
    right = CorrectionChain((STEPS["Dark"], STEPS["White"])).apply(frame())
    np.testing.assert_allclose(right, white.apply(dark.apply(frame())), rtol=1e-6)
    assert np.abs(dark.apply(white.apply(frame())) - right).max() > 1


def test_a_step_comes_once_and_is_a_step() -> None:
    with pytest.raises(InputError, match="expected one Dark or DarkSet, got Dark and Dark; merge them into one"):
        CorrectionChain((Dark(level=1.0), Dark(level=2.0)))
    # a set of darks was ignored next to a dark, in either order: 100 counts were left in the frame
    steps = (Dark(level=10.0), DarkSet({0.02: Dark(level=100.0)}))
    for both in (steps, steps[::-1]):
        with pytest.raises(InputError, match="expected one Dark or DarkSet, got Dark"):
            CorrectionChain(both)
    words = "correction: expected PixelMask, Dark, White, Defects, Background or Exposure, got str"
    with pytest.raises(InputError, match=words):
        CorrectionChain(("dark",))  # type: ignore[arg-type]


def test_shapes_must_fit() -> None:
    with pytest.raises(InputError, match="size of White: expected 3 x 4 px, as in Dark, got 48 x 60 px"):
        CorrectionChain((Dark(np.ones((3, 4))), STEPS["White"]))
    with pytest.raises(InputError, match="expected 48 x 60 px, as in the calibration frames, got 60 x 48 px"):
        chain().apply(frame().T, exposure_s=1.0)
    with pytest.raises(InputError, match=r"expected 48 x 60 px, as in the calibration frames, got 20 x 30 px"):
        corrected(ArraySource(session()), chain())
    with pytest.raises(InputError, match="pass one frame at a time"):
        chain().apply(frame()[None])
    with pytest.raises(InputError, match=r"part of a frame: expected shape \(2, 3\), got \(3, 3\)"):
        chain().apply_region(frame()[:3, :3], (slice(0, 2), slice(0, 3)), exposure_s=1.0)
    with pytest.raises(InputError, match="output array: expected contiguous float32"):
        chain().apply(frame(), exposure_s=1.0, out=np.empty(SHAPE))  # type: ignore[arg-type]


def test_measured_background_needs_the_frame() -> None:
    raw, region = frame(), (slice(4, 30), slice(7, 20))
    steps = chain(kind="plane")
    with pytest.raises(InputError, match=r"the result of measure\(\) for this frame, got none"):
        steps.apply_region(raw[region], region, exposure_s=0.1)
    plane = steps.measure(lambda part: raw[part], SHAPE, exposure_s=0.1)
    inside = (slice(10, 20), slice(12, 15))
    result = steps.apply_region(raw[region], region, inside=inside, exposure_s=0.1, background=plane)
    np.testing.assert_allclose(result, steps.apply(raw, exposure_s=0.1)[inside], rtol=1e-6, atol=1e-3)


def test_unknown_exposure_names_the_frame() -> None:
    source = corrected(ArraySource(frame()[None], [(0, 0, 0)], name="run"), CorrectionChain((Exposure(0.1),)))
    with pytest.raises(InputError, match=r"run\[0\]: exposure of the frame: expected a time in seconds, got none"):
        source.read(0)


UNUSABLE: list[tuple[Callable[[], object], str]] = [
    (lambda: White(np.zeros(SHAPE), 0.0), "light above the dark level"),
    (lambda: White(DARK, WHITE), "white and dark are not swapped"),
    (lambda: White(WHITE, DARK[:-1]), "dark frame for the white frame"),
    (lambda: White(WHITE, 0.0, floor=0.0), "white floor"),
    (lambda: White(np.full(SHAPE, 65535, np.uint16), 0.0), "saturated, got 100 %; reduce its exposure"),
    (lambda: White(WHITE, 0.0, saturation=4000), "at most 0.1 % saturated"),
    (lambda: White(np.where(WHITE > 3000, np.nan, WHITE), 0.0), "white frame: expected finite values"),
    (lambda: Dark(np.zeros((2, 3, 4))), "dark frame: expected a 2-D frame"),
    (lambda: Dark(np.array([[np.inf]])), "dark frame: expected finite values"),
    (lambda: Dark(level=np.nan), "dark level"),
    (lambda: Exposure(0.0), "reference exposure"),
    (lambda: Background("mean"), "background: expected constant, border or plane"),
    (lambda: Background("border", width=0), "background border"),
    (lambda: average_frames([]), "frames to average: expected at least one"),
    (lambda: average_frames([np.ones((2, 3)), np.ones((3, 2))]), "frame 1 of the average"),
]


def test_unusable_steps_are_refused() -> None:
    for make, words in UNUSABLE:
        with pytest.raises(InputError) as caught:
            make()
        assert words in str(caught.value) and "\n" not in str(caught.value)
    frames = session((5, 20, 30))
    np.testing.assert_allclose(average_frames(iter(frames)), frames.mean(axis=0), rtol=1e-6)


def test_description_is_json_and_changes_with_the_frames() -> None:
    record = json.loads(json.dumps(chain("GRBG", "plane").describe()))
    assert [step["kind"] for step in record["steps"]] == ["dark", "white", "defects", "background", "exposure"]
    other = CorrectionChain((Dark(DARK + 1, 12.5),)).describe()
    assert other["steps"][0]["crc32"] != record["steps"][0]["crc32"]
    source = corrected(ArraySource(frame()[None], [(0, 0, 0)]), CorrectionChain((Dark(DARK),)))
    assert json.loads(json.dumps(source.metadata.corrections))["steps"][0]["kind"] == "dark"


def test_corrected_is_a_source_again() -> None:
    places, drifts = [(0, 0, 1), (0, 1, 0)], [(0, 0), (1, 2)]
    source = ArraySource(np.stack([frame()] * 2), places, exposures_s=[0.1, 0.2], drifts=drifts)
    view = corrected(source, CorrectionChain((Dark(DARK),)))
    assert (len(view), view.shape, view.dtype, view.info(1).position) == (2, SHAPE, np.dtype(np.float32), (0, 1, 0))
    assert view.info(1).drift == (1, 2) and view.info(1).exposure_s == 0.2 and view.info(1).label == "frames[1]"
    again = corrected(view, CorrectionChain((Exposure(0.1),)))
    np.testing.assert_allclose(again.read(1), view.read(1) / 2, rtol=1e-6)
    np.testing.assert_array_equal(again.read(1, (slice(0, 5), slice(2, 6))), again.read(1)[:5, 2:6])


@pytest.mark.hard_case
def test_exposures_that_no_camera_has_are_refused() -> None:
    """Of a damaged file: the ratio of two of them was infinite, and the values of the frames were not numbers."""
    for seconds in (2.1e-314, 0.0, -0.1, float("nan"), float("inf"), 1e300):
        with pytest.raises(InputError, match="exposure of the frame"):
            Exposure(0.02).factor(seconds)
        with pytest.raises(InputError, match="reference exposure"):
            Exposure(seconds)
        with pytest.raises(InputError, match=r"exposure_s of a\.png"):
            FrameEntry("a.png", Position(0, 0, 0), exposure_s=seconds)
    assert Exposure(1e9).factor(1e-12) == pytest.approx(1e21)


# -- background --------------------------------------------------------------------------------------------------------


def test_strips_cover_the_border_once() -> None:
    for shape, width in (((30, 40), 5), ((30, 40), 14), ((30, 40), 15), ((3, 4), 8), ((1, 1), 1)):
        count, expected = np.zeros(shape, int), np.ones(shape, int)
        for region in border_strips(shape, width):
            count[region] += 1
        if 2 * width < min(shape):
            expected[width:-width, width:-width] = 0
        np.testing.assert_array_equal(count, expected, err_msg=f"{shape} {width}")


def tilted(noise: float = 0.0) -> np.ndarray:
    rows, columns = np.indices((200, 300))
    return (50 + 0.1 * rows - 0.05 * columns + np.random.default_rng(5).normal(0, noise, rows.shape)).astype(np.float32)


def background(frame: np.ndarray, kind: str, *values: float, **how: int) -> np.ndarray:
    return CorrectionChain((Background(kind, *values, **how),)).apply(frame)


def test_spots_on_the_border_and_light_in_the_middle_do_not_move_the_plane() -> None:
    assert np.abs(background(tilted(), "plane")).max() < 1e-3, "found to rounding"
    frame = tilted(2.0)
    frame[:8, 100:110] += 3000
    frame[60:150, 80:220] += 1000
    clean = background(frame, "plane")
    rest = np.ones(frame.shape, bool)
    rest[:8, 100:110] = rest[60:150, 80:220] = False
    assert abs(clean[rest].mean()) < 0.2
    assert np.abs(clean[rest] - (frame - tilted())[rest]).max() < 0.5


def test_the_border_gives_its_median_and_what_lies_below_is_negative() -> None:
    frame = np.full((50, 60), 7, np.uint16)
    frame[20:30, 20:30] = 500
    frame[25, 25] = 2
    clean = background(frame, "border", width=3)
    assert (clean[0, 0], clean[22, 22], clean[25, 25]) == (0, 493, -5)
    assert background(frame, "constant", 7.5)[25, 25] == -5.5


def test_the_background_of_frames_too_small_or_masked() -> None:
    np.testing.assert_allclose(background(np.full((2, 2), 5.0), "plane"), 0, atol=1e-5)
    masked = np.full((20, 30), np.nan, np.float32)
    assert np.isnan(background(masked, "plane")).all()
    masked[10, 10] = 4
    masked[0, :] = 3
    assert background(masked, "border")[10, 10] == 1


# -- variance ----------------------------------------------------------------------------------------------------------


SMALL = (60, 80)
REPEATS = 160
SENSOR = Truth(gain=0.2, read_e=8.0, black=64.0, dsnu_e=0.0, prnu=0.0, dark_e_s=40.0, shape=SMALL)
NOISE = Noise((8 * 0.2) ** 2 + 1 / 12, 0.2, 64.0)
SCENE = 0.8 * SENSOR.full_e * micro_images(SMALL)


def plan_of(marks: dict[str, str] | None = None, **sensor: object) -> ScanPlan:
    bench = preset("bench")
    values = {"shape": SMALL, "bit_depth": 12, "black_level": 64.0, "read_noise_e": 8.0, "full_well_e": 4031 / 0.2}
    camera = replace(bench, sensor=replace(bench.sensor, **(values | sensor)), marks=bench.marks)
    marked = camera.marks
    for path, mark in (marks or {}).items():
        marked = marked.marked([path], mark)
    return ScanPlan.for_camera(replace(camera, marks=marked), virtual_depths=[3.0], cutout=21)


def excess(values: np.ndarray, predicted: np.ndarray, light: np.ndarray, levels: int = 4) -> np.ndarray:
    """Return measured over predicted variance of pixels of like light, ``(levels,)``; 1 for a true prediction."""
    order = np.array_split(np.argsort(light.ravel()), levels)
    ratio = (values.var(axis=0, ddof=1) / predicted).ravel()
    return np.array([ratio[part].mean() for part in order])


@pytest.mark.parametrize("exposure_s", [0.5, 2.0])
def test_dark_white_exposure_and_background_pass_the_variance_on_pixel_by_pixel(exposure_s: float) -> None:
    """Every repeat has a separate dark, whose noise counts; the white differs from pixel to pixel."""
    white = White(1000 * vignetting(SMALL, 0.8) ** 2, 0.0, floor=0.1)
    values, predicted = [], []
    for k in range(REPEATS):
        darks = SENSOR.darks(3, exposure_s, key=50_000 + 10 * k)
        chain = CorrectionChain(
            (Dark(np.mean(darks, axis=0), count=3), white, Exposure(1.0), Background("constant", 3.0))
        )
        frame = SENSOR.frame(SCENE, exposure_s, key=k)
        raw = ArraySource(frame[None], [(0, 0, 0)], exposures_s=[exposure_s], metadata={"noise": NOISE})
        found = corrected(raw, chain).samples(0)
        assert found.noise is not None
        values.append(found.values)
        predicted.append(found.noise.variance(found.values))
    ratios = excess(np.array(values), np.mean(predicted, axis=0), SCENE)
    chance = np.sqrt(2 / (REPEATS - 1) / (np.prod(SMALL) / 4))
    np.testing.assert_allclose(ratios, 1.0, atol=0.01 + 4 * chance)
    # the counter-test: without the darks' own noise and the pixels' own gains the dim quarter is far off
    assert abs(excess(np.array(values), np.full(SMALL, np.mean(predicted)), SCENE)[0] - 1) > 0.5


def test_black_is_no_light() -> None:
    """Raw samples count from zero, light from the black level: 64 counts of black have no photon noise."""
    frames = np.array([SENSOR.frame(0.0, key=k) for k in range(40)])
    source = ArraySource(frames, [(0, 0, k) for k in range(40)], metadata={"noise": NOISE})
    noise = source.samples(0).noise
    assert noise is not None
    # noise above the black level is taken for light: sqrt(1/2 pi) of it on the mean, which is 5 % here
    assert frames.var(axis=0, ddof=1).mean() == pytest.approx(noise.variance(frames[0]).mean(), rel=0.08)
    level = corrected(source, CorrectionChain((Dark(level=64.0),))).samples(0)
    assert level.noise is not None and level.noise.constant == pytest.approx(NOISE.constant)
    assert level.noise.variance(level.values).mean() == pytest.approx(frames.var(axis=0, ddof=1).mean(), rel=0.08)


def test_a_hot_pixel_brings_its_own_photon_noise() -> None:
    dark = np.full(SMALL, 64.0, np.float32)
    dark[3, 4] = 1064.0
    for black in (64.0, None):
        source = ArraySource(
            np.full((1, *SMALL), 1100, np.uint16), [(0, 0, 0)], metadata={"noise": NOISE._replace(black=black)}
        )
        noise = corrected(source, CorrectionChain((Dark(dark),))).samples(0).noise
        assert noise is not None and isinstance(noise.constant, np.ndarray)
        assert noise.constant[3, 4] == pytest.approx(NOISE.constant + 0.2 * 1000)
        assert noise.constant[0, 0] == pytest.approx(NOISE.constant), "black without a known level is no light either"


def test_noise_and_saturation_are_the_sensors_unless_assumed() -> None:
    values = np.full((1, *SMALL), 100, np.uint16)
    values[0, 1, 2:6] = 3000, 3001, 3500, 4095
    raw = ArraySource(values, [(0, 0, 0)])
    stated = DescribedSource(raw, plan_of()).samples(0).noise
    assert stated == sensor_noise(plan_of().camera.sensor) == stated_noise(plan_of().camera)
    for path in ("sensor.read_noise_e", "sensor.full_well_e"):
        assert DescribedSource(raw, plan_of({path: "assumed"})).samples(0).noise is None
        assert DescribedSource(raw, plan_of({path: "measured"})).samples(0).noise == stated
    source = DescribedSource(raw, plan_of(saturation=3001.0))
    found = source.samples(0)
    assert found.saturated == 3 and source.metadata.saturation == 3001.0, "below the highest value"
    assert found.valid is not None and found.valid[1, 2] and not found.valid[1, 3]
    # left-aligned noise is moved down with the samples
    aligned = ArraySource(np.full((1, 4, 4), 1600, np.uint16), [(0, 0, 0)], metadata={"noise": NOISE.scaled(16.0)})
    noise = ShiftedSource(aligned, 4).samples(0).noise
    assert noise is not None and (noise.constant, noise.slope, noise.black) == pytest.approx(NOISE)
