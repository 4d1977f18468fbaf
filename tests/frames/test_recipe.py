"""Paths and choices become a correction chain that fits the frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.errors import InputError, StorageError
from lfcal.frames import ArraySource, Background, CorrectionChain, Dark, Exposure, White, channel_source, corrected
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
    recipe = CorrectionRecipe(folder / "dark", folder / "white.tif", "pixels", background="3.5", reference_s=0.1)
    chain = build_chain(source(bit_depth=12), recipe)
    by_hand = CorrectionChain((Dark(mean), White(WHITE, mean), Background("constant", 3.5), Exposure(0.1)), 4095.0)
    np.testing.assert_allclose(corrected(source(), chain).read(1), corrected(source(), by_hand).read(1), atol=1e-3)
    assert chain.saturation == 4095


def test_channel_of_a_mosaic_takes_the_channel_of_its_calibration_frames(folder: Path) -> None:
    recipe = CorrectionRecipe(folder / "dark", folder / "white.tif", "pixels")
    mosaic = source(cfa="GRBG", saturation=4000.0, black_level=(7.0,) * 4)
    red = channel_source(mosaic, "R")
    single = corrected(red, build_chain(red, recipe))
    whole = corrected(mosaic, build_chain(mosaic, recipe))
    np.testing.assert_allclose(single.read(0), whole.read(0)[0::2, 1::2], rtol=1e-6)
    assert single.chain.saturation == 4000


def test_declared_black_level_stands_in_for_a_dark_frame() -> None:
    chain = build_chain(source(cfa="GRBG", black_level=(64.0,) * 4), CorrectionRecipe())
    assert chain.describe()["steps"] == [{"kind": "dark", "level": 64.0}]
    with pytest.raises(InputError, match="black level of the colours: expected one for all"):
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
