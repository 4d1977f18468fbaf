"""Paths and choices become a correction chain that fits the frames; left-aligned samples; channels of a mosaic."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError, StorageError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import (
    ArraySource,
    Background,
    CorrectionChain,
    Dark,
    Exposure,
    White,
    balanced_source,
    channel_source,
    corrected,
    corrected_view,
    open_frames,
)
from lfcal.frames.aligned import ShiftedSource, chosen_shift, find_shift
from lfcal.frames.corrections.recipe import CorrectionRecipe, build_chain, read_average
from tests.frames.scenes import session

FRAMES = session((2, 20, 30))
DARKS = session((3, 20, 30), seed=5, top=60)
WHITE = session((20, 30), seed=6, top=100) + np.uint16(3000)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "dark").mkdir()
    for k, dark in enumerate(DARKS):
        tifffile.imwrite(tmp_path / "dark" / f"{k}.tif", dark)
    tifffile.imwrite(tmp_path / "white.tif", WHITE)
    return tmp_path


def source(**metadata: object) -> ArraySource:
    return ArraySource(FRAMES, [(0, 0, 0), (0, 0, 1)], exposures_s=[0.1, 0.2], metadata=metadata)


def test_calibration_frames_are_averaged(folder: Path) -> None:
    mean = DARKS.mean(axis=0)
    np.testing.assert_allclose(read_average(folder / "dark"), mean, rtol=1e-6)
    recipe = CorrectionRecipe(
        dark=folder / "dark", white=folder / "white.tif", white_mode="pixels", background="3.5", exposure="0.1"
    )
    chain = build_chain(source(), recipe)
    by_hand = CorrectionChain((Dark(mean), White(WHITE, mean), Background("constant", 3.5), Exposure(0.1)))
    np.testing.assert_allclose(corrected(source(), chain).read(1), corrected(source(), by_hand).read(1), atol=1e-3)


def test_channel_of_a_mosaic_takes_the_channel_of_its_calibration_frames(folder: Path) -> None:
    recipe = CorrectionRecipe(dark=folder / "dark", white=folder / "white.tif", white_mode="pixels")
    mosaic = source(cfa="GRBG", saturation=4000.0, black_level=(7.0,) * 4)
    red = channel_source(mosaic, "R")
    single = corrected(red, build_chain(red, recipe))
    whole = corrected(mosaic, build_chain(mosaic, recipe))
    np.testing.assert_allclose(single.read(0), whole.read(0)[0::2, 1::2], rtol=1e-6)
    assert single.metadata.saturation == 4000


def test_declared_black_level_stands_in_for_a_dark_frame() -> None:
    chain = build_chain(source(cfa="GRBG", black_level=(64.0,) * 4), CorrectionRecipe(exposure="none"))
    assert chain.describe()["steps"] == [{"kind": "dark", "level": 64.0}]
    with pytest.raises(InputError, match="black level: expected one level for all colours"):
        build_chain(source(black_level=(64.0, 65.0, 64.0, 64.0)), CorrectionRecipe())


def test_unusable_recipes(folder: Path) -> None:
    with pytest.raises(InputError, match="background: expected none, border, plane or a number of counts, got 'mean'"):
        build_chain(source(), CorrectionRecipe(background="mean"))
    with pytest.raises(StorageError, match="no such file or folder"):
        build_chain(source(), CorrectionRecipe(dark=folder / "absent"))
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match="at least one image, got none"):
        build_chain(source(), CorrectionRecipe(white=folder / "empty"))
    with pytest.raises(InputError, match=r"at most 0\.1 % saturated, got 100 %"):
        build_chain(source(saturation=3000.0), CorrectionRecipe(white=folder / "white.tif", white_mode="pixels"))


def test_unequal_exposures_are_scaled_to_the_most_frequent_one() -> None:
    raw = np.stack([FRAMES[0], FRAMES[0], FRAMES[0] * 2])
    frames = ArraySource(raw, [(0, 0, k) for k in range(3)], exposures_s=[0.1, 0.1, 0.2])
    view = corrected_view(frames, CorrectionRecipe())
    np.testing.assert_allclose(view.read(2), view.read(0), rtol=1e-6)
    np.testing.assert_array_equal(view.read(0), raw[0])
    np.testing.assert_array_equal(corrected_view(frames, CorrectionRecipe(exposure="none")).read(2), raw[2])
    with pytest.raises(InputError, match="exposure: expected auto, none or seconds, got 'long'"):
        corrected_view(frames, CorrectionRecipe(exposure="long"))


def test_exposures_known_of_some_frames_only_cannot_be_normalised(tmp_path: Path) -> None:
    for k in range(3):
        tifffile.imwrite(tmp_path / f"{k}.tif", FRAMES[0])
    (tmp_path / "manifest.csv").write_text("file,z,y,x,exposure_s\n0.tif,0,0,0,0.1\n1.tif,0,0,1,0.2\n2.tif,0,0,2,\n")
    with open_frames(tmp_path) as frames:
        words = r"exposure for every frame, .* got 1 frame without one; add .* to the manifest"
        with pytest.raises(InputError, match=words):
            corrected_view(frames, CorrectionRecipe())
        assert corrected_view(frames, CorrectionRecipe(exposure="none")).read(1).max() == FRAMES[0].max()


def plan_of(**sensor: object) -> ScanPlan:
    bench = preset("bench")
    described = replace(bench, sensor=replace(bench.sensor, **sensor))
    return ScanPlan.for_camera(described, virtual_depths=[3, 4], exposure_s=(0.02, 0.05))


def test_the_plan_states_what_the_frames_do_not() -> None:
    plan = plan_of(bit_depth=12, black_level=64.0)
    raw = np.full((2, 20, 30), 100, np.uint16)
    raw[1, 3, 4] = 4095
    places = [(0, 0, 0), (1, 0, 0)]
    view = corrected_view(ArraySource(raw, places), CorrectionRecipe(), plan)
    assert [view.info(k).exposure_s for k in (0, 1)] == [0.02, 0.05]
    np.testing.assert_allclose(view.read(1)[0, 0] / view.read(0)[0, 0], 0.02 / 0.05, rtol=1e-6)
    assert view.samples(0).saturated == 0 and view.samples(1).saturated == 1, "12 bits end at 4095"
    assert view.samples(0).noise is not None
    own = corrected_view(
        ArraySource(raw, places, metadata={"bit_depth": 16, "saturation": 65535.0}), CorrectionRecipe(), plan
    )
    assert own.samples(1).saturated == 0, "what a frame says of itself counts first"
    floats = corrected_view(ArraySource(raw.astype(np.float32), places), CorrectionRecipe(exposure="none"), plan)
    np.testing.assert_array_equal(floats.read(0), raw[0])
    assert floats.samples(1).saturated is None, "floats are not raw samples of the plan's sensor"


def test_left_aligned_samples_are_named_and_shifted() -> None:
    plan = plan_of(bit_depth=12, black_level=0.0)
    raw = (np.arange(600).reshape(1, 20, 30) % 4000).astype(np.uint16)
    aligned = ArraySource(raw << 4, [(0, 0, 0)])
    words = r"values up to 4095 \(12 bits, as the plan says\), got \d+; shift left-aligned"
    with pytest.raises(InputError, match=words):
        corrected_view(aligned, CorrectionRecipe(), plan).read(0)
    view = corrected_view(aligned, CorrectionRecipe(shift=4), plan)
    np.testing.assert_array_equal(view.read(0), raw[0])
    assert view.samples(0).saturated == 0
    with pytest.raises(InputError, match="samples with 4 unused low bits, got samples that use them"):
        corrected_view(ArraySource(raw, [(0, 0, 0)]), CorrectionRecipe(shift=4), plan).read(0)


def test_darks_of_a_recording_are_taken_by_exposure_and_place() -> None:
    sensor = np.random.default_rng(3).integers(50, 70, (20, 30)).astype(np.float32)
    darks = {t: Dark(sensor[4:16, 5:25] * t, origin=(4, 5)) for t in (1.0, 2.0)}
    raw = np.full((2, 6, 8), 500, np.uint16)
    places, origins = [(0, 0, 0), (0, 0, 1)], [(4, 5), (9, 16)]
    frames = ArraySource(raw, places, exposures_s=[1.0, 2.0], origins=origins, metadata={"darks": darks})
    view = corrected_view(frames, CorrectionRecipe(exposure="none"))
    np.testing.assert_allclose(view.read(0), 500 - sensor[4:10, 5:13])
    np.testing.assert_allclose(view.read(1), 500 - 2 * sensor[9:15, 16:24])
    np.testing.assert_array_equal(
        corrected_view(frames, CorrectionRecipe(dark="none", exposure="none")).read(1), raw[1]
    )
    level = corrected_view(frames, CorrectionRecipe(black_level=64.0, exposure="none"))
    np.testing.assert_array_equal(level.read(1), raw[1] - 64.0)
    off = ArraySource(raw, places, exposures_s=[1.0, 2.0], origins=[(0, 0), (9, 16)], metadata={"darks": darks})
    with pytest.raises(InputError, match=r"frames\[0\]: dark frame: expected rows 0 … 5"):
        corrected_view(off, CorrectionRecipe(exposure="none")).read(0)
    other = ArraySource(raw, places, exposures_s=[1.0, 3.0], origins=origins, metadata={"darks": darks})
    with pytest.raises(InputError, match="exposure of the dark frame: expected 3 s, got 1, 2 s"):
        corrected_view(other, CorrectionRecipe(exposure="none")).read(1)


def test_what_does_not_fit_cutouts_is_refused() -> None:
    values, places = np.full((2, 6, 8), 500, np.uint16), [(0, 0, 0), (0, 0, 1)]
    frames = ArraySource(values, places, origins=[(4, 5), (4, 6)], metadata={"cfa": "GRBG"})
    for choice, words in (
        ({"background": "border"}, "background: expected a constant for cutouts"),
        ({"defects": True}, "search for defect pixels: expected whole sensor frames, got cutouts"),
        ({"channel": "R"}, "channel R of .*: expected cutouts that start at the same pixel of the colour pattern"),
    ):
        with pytest.raises(InputError, match=words):
            corrected_view(frames, CorrectionRecipe(**choice)).read(1)  # type: ignore[arg-type]


def test_corrections_of_a_channel_of_cutouts(tmp_path: Path) -> None:
    """Dark, white and masked pixels are those of the whole mosaic, at the place of each cutout."""
    rng = np.random.default_rng(0)
    sensor = rng.integers(200, 4000, (2, 20, 24)).astype(np.uint16)
    dark, white = rng.uniform(50, 90, (20, 24)).astype(np.float32), rng.uniform(2000, 3000, (20, 24)).astype(np.float32)
    origins = [(3, 4), (5, 8)]
    cut = np.stack([one[r : r + 9, c : c + 11] for one, (r, c) in zip(sensor, origins, strict=True)])
    frames = ArraySource(cut, [(0, 0, 0), (0, 0, 1)], origins=origins, metadata={"cfa": "GRBG"})
    np.save(tmp_path / "dark.npy", dark)
    np.save(tmp_path / "white.npy", white)
    (tmp_path / "mask.csv").write_text("row,column\n# a dead pixel\n8,13\n")
    how = {"dark": tmp_path / "dark.npy", "white": tmp_path / "white.npy", "white_mode": "pixels", "exposure": "none"}
    view = corrected_view(frames, CorrectionRecipe(channel="R", mask=tmp_path / "mask.csv", **how))
    part, ratios = (white - dark)[0::2, 1::2], []
    for k, (r, c) in enumerate(origins):
        r0, c0 = -r % 2, (1 - c) % 2
        place = ((r + r0) // 2, (c + c0 - 1) // 2)
        assert view.info(k).origin == place
        values = (cut[k] - dark[r : r + 9, c : c + 11])[r0::2, c0::2]
        rows, columns = values.shape
        wanted = values / part[place[0] : place[0] + rows, place[1] : place[1] + columns]
        found = view.samples(k)
        lost = np.zeros((rows, columns), bool)
        lost[8 // 2 - place[0], 13 // 2 - place[1]] = True
        np.testing.assert_array_equal(found.valid, ~lost)
        ratios.append(found.values[~lost] / wanted[~lost])
    np.testing.assert_allclose(np.concatenate(ratios), ratios[0][0], rtol=1e-5)  # one factor for the whole sensor


def test_a_level_that_no_sample_can_have_is_refused() -> None:
    for shift, level in product((0, 4), ("black_level", "saturation")):
        most = 65535 >> shift
        corrected_view(source(), CorrectionRecipe(shift=shift, **{level: float(most)}))
        with pytest.raises(InputError, match=f"at most {most}, the largest sample") as caught:
            corrected_view(source(), CorrectionRecipe(shift=shift, **{level: 16.0 * most + 15}))
        assert ("after a shift by 4 bits, got 65535; give 4095.94" in str(caught.value)) == (shift == 4)


def test_a_dark_frame_and_a_black_level_do_not_go_together(folder: Path) -> None:
    with pytest.raises(InputError, match=r"a dark frame or a number, got both \(.* and 5\); omit one"):
        build_chain(source(), CorrectionRecipe(dark=folder / "dark", black_level=5.0))
    # of darks recorded with the frames, the level that was stated takes the place
    chain = build_chain(source(), CorrectionRecipe(dark="none", black_level=5.0))
    assert chain.describe()["steps"][0] == {"kind": "dark", "level": 5.0}


# -- left-aligned samples ----------------------------------------------------------------------------------------------


SHIFTED = session((1, 2, 4, 24, 30), top=1000).reshape(8, 24, 30)


def series(frames: np.ndarray, **facts: object) -> ArraySource:
    return ArraySource(frames, [(0, y, x) for y in range(2) for x in range(4)], metadata=facts)


def test_alignment_is_found_and_applied_or_proposed() -> None:
    for bits in (0, 1, 2, 4, 6):
        assert find_shift(series(SHIFTED << np.uint16(bits))) == bits
        shift, note = chosen_shift("auto", series(SHIFTED << np.uint16(bits)))
        assert shift == bits and (f"shifted down to {16 - bits} bits" in note or not bits)
    # frames without light do not mislead
    frames = (SHIFTED << np.uint16(4)).copy()
    frames[0] = 0
    frames[-1] = 1024
    frames[-1, 5, 5] = 2048
    assert find_shift(series(frames)) == 4
    assert find_shift(series(frames.astype(np.float32))) == 0
    assert "--shift auto" in chosen_shift("0", series(SHIFTED << np.uint16(4)))[1]
    assert chosen_shift("0", series(SHIFTED)) == (0, "") and chosen_shift("4", series(SHIFTED)) == (4, "")
    with pytest.raises(InputError, match="auto or a number of bits, got 'four'"):
        chosen_shift("four", series(SHIFTED))


def test_a_mixture_of_alignments_is_refused() -> None:
    frames = (SHIFTED << np.uint16(4)).copy()
    frames[-1] >>= 4
    with pytest.raises(InputError, match=r"the same in all frames, got 0 unused low bits in .* and 4 in"):
        chosen_shift("auto", series(frames))
    shift, note = chosen_shift("0", series(frames))
    assert shift == 0 and "the same in all frames" in note
    hidden = (SHIFTED << np.uint16(4)).copy()
    hidden[2] += 1  # a frame that is not looked at shows when it is read
    view = ShiftedSource(series(hidden), find_shift(series(hidden)))
    with pytest.raises(InputError, match="samples with 4 unused low bits, got samples that use them"):
        view.read(2)


def test_levels_move_with_the_samples() -> None:
    plain = ShiftedSource(series(SHIFTED << np.uint16(4)), 4)
    assert plain.metadata.bit_depth == 12 and plain.metadata.saturation == 4095
    stated = ShiftedSource(series(SHIFTED << np.uint16(4), saturation=65520.0, black_level=(160.0, 320.0)), 4)
    assert stated.metadata.saturation == 4095 and stated.metadata.black_level == (10, 20)
    full = (SHIFTED << np.uint16(4)).copy()
    full[0, 0, 0] = 4095 << 4
    assert ShiftedSource(series(full), 4).samples(0).saturated == 1


# -- channels ----------------------------------------------------------------------------------------------------------


MOSAICS = session((2, 21, 30))


def mosaic(cfa: str = "GRBG", **more: object) -> ArraySource:
    known = {"cfa": cfa, "black_level": (1.0, 2.0, 3.0, 4.0), "saturation": 4095.0, **more}
    return ArraySource(MOSAICS, [(0, 0, 0), (0, 0, 1)], drifts=[(0, 0), (1.0, -3.0)], metadata=known)


def test_channel_of_a_bayer_mosaic() -> None:
    for channel, (r, c) in {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}.items():
        found = channel_source(mosaic(), channel)
        assert found.shape == MOSAICS[0, r::2, c::2].shape
        np.testing.assert_array_equal(found.read(1), MOSAICS[1, r::2, c::2])
        assert found.dtype == np.uint16 and found.info(1).position == (0, 0, 1)
        assert found.metadata.channel_phase == (r, c) and found.metadata.pixel_step == 2
        assert found.metadata.black_level == 2 * r + c + 1 and found.metadata.cfa == ""
        assert found.info(1).drift == (0.5, -1.5)
        assert found.info(1).label == f"frames[1] {channel}"
    # a pattern of four by four
    cfa, names = "RRGGRRGGGGBBGGBB", {"R1": (0, 0), "R2": (0, 1), "R3": (1, 0), "G8": (3, 1), "B4": (3, 3)}
    for name, (r, c) in names.items():
        np.testing.assert_array_equal(channel_source(mosaic(cfa), name).read(0), MOSAICS[0, r::4, c::4])
    clean = corrected(mosaic(), CorrectionChain((Dark(level=10.0),)))
    np.testing.assert_array_equal(channel_source(clean, "R").read(0), MOSAICS[0, 0::2, 1::2].astype(np.float32) - 10)


@given(st.integers(0, 9), st.integers(1, 10), st.integers(0, 14), st.integers(1, 15), st.sampled_from(["G1", "R", "B"]))
@settings(derandomize=True, deadline=None, max_examples=40)
def test_region_of_a_channel_is_its_crop(r: int, rows: int, c: int, columns: int, channel: str) -> None:
    for source in (channel_source(mosaic(), channel), balanced_source(mosaic(), (1.0, 2.0, 3.0, 1.5))):
        at = slice(r, min(source.shape[0], r + rows)), slice(c, min(source.shape[1], c + columns))
        np.testing.assert_array_equal(source.read(1, at), source.read(1)[at])


def test_gains_multiply_each_colour() -> None:
    gains = (1.0, 2.0, 4.0, 1.5)
    expected = MOSAICS[0].astype(np.float32)
    for k, gain in enumerate(gains):
        expected[k // 2 :: 2, k % 2 :: 2] *= np.float32(gain)
    for source in (balanced_source(mosaic(), gains), balanced_source(mosaic(gains=gains))):
        np.testing.assert_array_equal(source.read(0), expected)
        assert source.dtype == np.float32 and source.metadata.balanced_by == gains
        assert source.metadata.saturation is None and source.metadata.cfa == "GRBG"


def test_unusable_gains_and_monochrome_frames_are_refused() -> None:
    for gains in (None, (1.0, 2.0), (1.0, 0.0, 1.0, 1.0), (1.0, float("nan"), 1.0, 1.0)):
        with pytest.raises(InputError, match="colour gains: expected positive numbers for G1, R, B, G2"):
            balanced_source(mosaic(), gains)
    with pytest.raises(InputError, match="monochrome"):
        channel_source(mosaic(""), "R")
    with pytest.raises(InputError, match="a colour mosaic"):
        balanced_source(mosaic(""), (1.0,))
