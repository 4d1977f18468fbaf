"""From paths and choices to a correction chain: what the command line and the window both ask for."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.checks import check_choice
from lfcal.errors import InputError, StorageError
from lfcal.frames.corrections.background import Background
from lfcal.frames.corrections.chain import CorrectionChain, Step
from lfcal.frames.corrections.steps import Dark, Exposure, White, average_frames
from lfcal.frames.formats.opening import IMAGE_SUFFIXES, open_image
from lfcal.frames.source import FrameSource

__all__ = ["CorrectionRecipe", "build_chain", "read_average"]


@dataclass(frozen=True)
class CorrectionRecipe:
    """Which corrections are made, with which calibration frames.

    Attributes
    ----------
    dark, white
        A frame, or a folder of frames that are averaged; empty: not corrected.
    white_mode
        ``"field"``: divide by the smooth fall of light over the field, found from the lenslets of the white
        frame, which leaves micro-images as they are; ``"pixels"``: divide by the white frame itself, pixel by
        pixel, for white frames without micro-images.
    white_floor
        Lowest relative brightness divided by.
    defects
        Find defect pixels over the frames and repair them.
    background
        ``"none"``, ``"border"``, ``"plane"``, or a number of counts.
    reference_s
        Scale all frames to this exposure (s); None: leave them.
    saturation
        Sample value of saturation; None: the sensor's highest value by bit depth.
    """

    dark: str | os.PathLike[str] = ""
    white: str | os.PathLike[str] = ""
    white_mode: str = "field"
    white_floor: float = 0.05
    defects: bool = False
    background: str = "none"
    reference_s: float | None = None
    saturation: float | None = None


def read_average(path: str | os.PathLike[str], *, colour: str | None = None) -> NDArray[np.float32]:
    """Return the mean of all pages of an image file, or of all images in a folder, ``(rows, columns)`` float32."""
    place = Path(path)
    if place.is_dir():
        files = sorted(p for p in place.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise InputError.expected(f"calibration frames in {place}", "at least one image", "none", "check it")
    elif place.exists():
        files = [place]
    else:
        raise StorageError(f"{place}: no such file or folder; check the path")
    return average_frames(page for file in files for page in _pages(file, colour))


def _pages(path: Path, colour: str | None) -> list[NDArray[Any]]:
    image = open_image(path, colour=colour)
    try:
        return [image.read(page) for page in range(image.pages)]
    finally:
        image.close()


def build_chain(source: FrameSource, recipe: CorrectionRecipe) -> CorrectionChain:
    """Return the correction chain of ``recipe`` for the frames of ``source``.

    Where these are one channel of a mosaic, the same channel is taken of the dark and white mosaics. Without a dark
    frame the black level that a camera RAW declares is subtracted.
    """
    steps: list[Step] = []
    cfa = str(source.metadata.get("cfa") or "")
    dark = _of_channel(source, read_average(recipe.dark)) if recipe.dark else None
    black = 0.0 if recipe.dark else _black_level(source)
    saturation = recipe.saturation if recipe.saturation is not None else _saturation(source)
    if dark is not None:
        steps.append(Dark(dark))
    elif black:
        steps.append(Dark(level=black))
    if recipe.white:
        white = _of_channel(source, read_average(recipe.white))
        level = black if dark is None else dark
        steps.append(_white(white, level, recipe, cfa, saturation))
    if recipe.defects:
        from lfcal.frames.corrections.defect_search import find_defects

        steps.append(find_defects(source))
    if recipe.background != "none":
        steps.append(_background(recipe.background))
    if recipe.reference_s is not None:
        steps.append(Exposure(recipe.reference_s))
    return CorrectionChain(tuple(steps), saturation=saturation)


def _white(
    white: NDArray[np.float32],
    dark: NDArray[np.float32] | float,
    recipe: CorrectionRecipe,
    cfa: str,
    saturation: float | None,
) -> White:
    check_choice("white correction", recipe.white_mode, ("field", "pixels"))
    if recipe.white_mode == "pixels":
        return White(white, dark, floor=recipe.white_floor, cfa=cfa, saturation=saturation)
    from lfcal.lattice.fit import fit_lattice
    from lfcal.lattice.vignetting import vignetting_map

    try:
        field = vignetting_map(fit_lattice(white, dark=dark)).frame()
    except InputError as error:
        raise InputError(f"{error}; or divide by the white frame itself (white mode pixels)") from None
    return White(field, 0.0, floor=recipe.white_floor)


def _of_channel(source: FrameSource, frame: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the part of a calibration frame that belongs to ``source``, where that is a channel of a mosaic."""
    step = int(source.metadata.get("pixel_step", 1))
    if step == 1 or frame.shape == source.shape:
        return frame
    r0, c0 = source.metadata["origin_px"]
    return np.ascontiguousarray(frame[r0::step, c0::step])


def _black_level(source: FrameSource) -> float:
    """Return the black level of camera RAW frames, 0 where there is none."""
    levels = np.atleast_1d(np.asarray(source.metadata.get("black_level", 0.0), float))
    if np.ptp(levels) > 0:
        raise InputError.expected("black level of the colours", "one for all", levels.tolist(), "give a dark frame")
    return float(levels[0])


def _saturation(source: FrameSource) -> float | None:
    if source.metadata.get("saturation") is not None:
        return float(source.metadata["saturation"])
    bits = source.metadata.get("bit_depth")
    return float((1 << int(bits)) - 1) if bits else None


def _background(text: str) -> Background:
    if text in ("border", "plane"):
        return Background(text)
    try:
        return Background("constant", float(text))
    except ValueError:
        raise InputError.expected(
            "background", "none, border, plane or a number of counts", repr(text), "correct it"
        ) from None
