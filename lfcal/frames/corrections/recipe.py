"""From paths and choices to a correction chain: what the command line and the window both ask for."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, StorageError, check_choice
from lfcal.camera import ScanPlan
from lfcal.frames.aligned import ShiftedSource, shifted
from lfcal.frames.channels import channel_source
from lfcal.frames.corrections._corrected import CorrectedSource
from lfcal.frames.corrections.chain import CorrectionChain, Step
from lfcal.frames.corrections.steps import (
    Background,
    Dark,
    DarkSet,
    Exposure,
    White,
    average_frames,
    difference_variance,
)
from lfcal.frames.described import DescribedSource
from lfcal.frames.formats import image_suffixes, open_image, split_dataset
from lfcal.frames.orientation import AS_IS
from lfcal.frames.source import FrameSource
from lfcal.records import CorrectionRecipe

__all__ = ["build_chain", "check_turned_colours", "corrected_view", "first_image", "read_average"]


def corrected_view(source: FrameSource, recipe: CorrectionRecipe, plan: ScanPlan | None = None) -> CorrectedSource:
    """Return the frames of ``source`` as ``recipe`` corrects them: the view that everything works on.

    Parameters
    ----------
    source
        Raw frames.
    recipe
        What is to be done.
    plan
        States bit depth, black level, exposures and colour filter where the frames do not.

    Raises
    ------
    InputError
        If something the recipe asks for does not fit these frames.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> with open_frames("session/frames") as source:
    ...     view = corrected_view(source, CorrectionRecipe(dark="session/dark"))
    ...     print(np.median(source.read(0)), abs(np.median(view.read(0)).round()))
    64.0 0.0
    """
    # samples first, then what they mean, then which of them: each view reads the facts of the one before
    view = ShiftedSource(source, recipe.shift) if recipe.shift else source
    _check_levels(source, recipe)
    if plan is not None:
        view = DescribedSource(view, plan)
    if recipe.channel:
        view = channel_source(view, recipe.channel)
    return CorrectedSource(view, build_chain(view, recipe))


def check_turned_colours(frames: FrameSource, plan: ScanPlan, recipe: CorrectionRecipe, applied: str) -> None:
    """Raise `InputError` where frames were turned whose colour pattern is known from the upright sensor only.

    Parameters
    ----------
    frames
        As delivered, before their corrections.
    plan
        Its sensor may have a colour filter.
    recipe
        The corrections; some look at single colours.
    applied
        Name of what makes the frames upright.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.base import InputError
    >>> from lfcal.frames import ArraySource, CorrectionRecipe, check_turned_colours
    >>> camera = preset("bench")
    >>> colour = replace(camera, sensor=replace(camera.sensor, cfa="RGGB"))
    >>> plan = ScanPlan.for_camera(colour, virtual_depths=[3])
    >>> frames = ArraySource(np.ones((1, *camera.sensor.shape)), [(0, 0, 0)])
    >>> try:
    ...     check_turned_colours(frames, plan, CorrectionRecipe(channel="G1"), "rot90")
    ... except InputError as error:
    ...     print(error)
    colour pattern of frames that are turned: expected one that the frames state as they are delivered, ...
    """
    used = recipe.channel or recipe.defects or recipe.white
    if applied == AS_IS or not used or frames.metadata.cfa or not plan.camera.sensor.cfa:
        return
    raise InputError.expected(
        "colour pattern of frames that are turned",
        "one that the frames state as they are delivered",
        f"that of the plan's upright sensor, {plan.camera.sensor.cfa}",
        "state it in the manifest, or turn the files themselves",
    )


def read_average(path: str | os.PathLike[str], *, colour: str | None = None, shift: int = 0) -> NDArray[np.float32]:
    """Return the mean of all pages of an image file, or of all images in a folder, ``(rows, columns)`` float32.

    Integer samples are moved down by ``shift`` bits first.
    """
    return _read_mean(path, colour, shift)[0]


def first_image(path: str | os.PathLike[str]) -> Path:
    """Return a file, or the first image of a folder."""
    return _images(Path(path))[0]


def _images(place: Path) -> list[Path]:
    """Return the images of a folder, sorted, or the one file that ``place`` is."""
    if place.is_dir():
        # sorted, so that the float sums and with them the checksums do not depend on the folder's order
        files = sorted(p for p in place.iterdir() if p.suffix.lower() in image_suffixes())
        if not files:
            raise InputError.expected(f"calibration frames in {place}", "at least one image", "none", "check it")
        return files
    if not split_dataset(place)[0].exists():
        raise StorageError(f"{place}: no such file or folder; check the path")
    return [place]


def _read_mean(
    path: str | os.PathLike[str], colour: str | None, shift: int
) -> tuple[NDArray[np.float32], int, float | None]:
    """Return the mean of frames, how many there are (0: they may be means themselves), and the variance of a sample.

    The variance is that between successive frames; None: there is one frame only.
    """
    place = Path(path)
    files = _images(place)
    counts: list[int] = []
    variances: list[float] = []

    def pages() -> Iterator[NDArray[Any]]:
        before: NDArray[Any] | None = None
        for page in (page for file in files for page in _pages(file, colour)):
            counts.append(int(page.dtype.kind in "iu"))
            now = shifted(page, shift, place.name) if shift else page
            if before is not None and before.shape == now.shape:
                variances.append(difference_variance(before, now))
            before = now
            yield now

    mean = average_frames(pages())
    # whole numbers are single exposures; floats are what somebody averaged, of how many nobody says
    return mean, len(counts) if all(counts) else 0, float(np.mean(variances)) if variances else None


def _pages(path: Path, colour: str | None) -> list[NDArray[Any]]:
    image = open_image(path, colour=colour)
    try:
        return [image.read(page) for page in range(image.pages)]
    finally:
        image.close()


def _check_levels(source: FrameSource, recipe: CorrectionRecipe) -> None:
    """Raise `InputError` for a level that no sample can have: those of left-aligned samples move down with them."""
    if source.dtype.kind != "u":
        return
    most = (1 << (8 * source.dtype.itemsize - recipe.shift)) - 1
    for name, level in (("black level", recipe.black_level), ("saturation", recipe.saturation)):
        if level is not None and level > most:
            after = f" after a shift by {recipe.shift} bits" if recipe.shift else ""
            what = f"give {level / (1 << recipe.shift):g}" if recipe.shift else "correct it"
            raise InputError.expected(name, f"at most {most}, the largest sample{after}", f"{level:g}", what)


def build_chain(source: FrameSource, recipe: CorrectionRecipe) -> CorrectionChain:
    """Return the correction chain of ``recipe`` for the frames of ``source``.

    Where these are one channel of a mosaic, the same channel is taken of the dark and white mosaics.
    """
    known = source.metadata
    dark = _dark(source, recipe)
    steps: list[Step] = [] if dark is None else [dark]
    if recipe.white:
        check_choice("white correction", recipe.white_mode, ("field", "pixels"))
        white = _of_channel(source, read_average(recipe.white, colour=known.colour, shift=recipe.shift))
        saturation = recipe.saturation if recipe.saturation is not None else known.saturation
        steps.append(_white(white, _white_dark(dark, white.shape), recipe, known.cfa, saturation))
    if recipe.defects:
        from lfcal.frames.corrections.defects import find_defects

        # the search compares one place of the sensor over all frames; cutouts lie at different places
        part = known.origin or (0, 0)
        if any(source.info(k).origin != part for k in range(len(source))):
            raise InputError.expected(
                "search for defect pixels", "whole sensor frames", "cutouts", "record whole frames for it"
            )
        steps.append(find_defects(source))
    if recipe.background != "none":
        steps.append(_background(recipe.background))
    reference = _reference_exposure(source, recipe.exposure)
    if reference is not None:
        steps.append(Exposure(reference))
    return CorrectionChain(tuple(steps), saturation=recipe.saturation)


def _dark(source: FrameSource, recipe: CorrectionRecipe) -> Dark | DarkSet | None:
    """Return what is subtracted first: the recipe's dark, that of the recording, or the black level."""
    if recipe.dark and recipe.dark != "none":
        if recipe.black_level is not None:
            got = f"the dark frame {recipe.dark} and black level {recipe.black_level:g}"
            raise InputError.expected("level of no light", "one source of it", got, "leave one of them out")
        frame, count, variance = _read_mean(recipe.dark, source.metadata.colour, recipe.shift)
        return Dark(_of_channel(source, frame), count=count, variance=variance)
    if recipe.black_level is None and recipe.dark == "none":
        return None
    darks, lost = source.metadata.darks, source.metadata.lost_darks
    if lost and recipe.black_level is None:
        raise InputError.expected(
            "recorded dark frames",
            f"a whole one of {', '.join(f'{seconds:g}' for seconds in lost)} s",
            "damaged ones",
            "record them again (lfcal acquire --resume), or give --dark or --black-level",
        )
    if darks and recipe.black_level is None:
        return DarkSet(darks)
    if recipe.black_level is not None:
        return Dark(level=recipe.black_level)  # 0 too: it says that there is none
    level = _black_level(source)
    return Dark(level=level) if level else None


def _white_dark(dark: Dark | DarkSet | None, shape: tuple[int, ...]) -> NDArray[np.float32] | float:
    """Return what is subtracted from the white image itself."""
    if dark is None:
        return 0.0
    one = dark.at(None) if isinstance(dark, DarkSet) and len(dark.darks) == 1 else dark
    if isinstance(one, DarkSet) or (one.frame is not None and one.frame.shape != shape):
        raise InputError.expected(
            "dark of the white image", "one for the whole sensor", "darks of a part of it", "give a dark frame"
        )
    return one.level if one.frame is None else one.frame


def _reference_exposure(source: FrameSource, wanted: str) -> float | None:
    """Return the exposure that frames are scaled to (s), or None to leave them."""
    if wanted == "none":
        return None
    if wanted != "auto":
        try:
            return float(wanted)
        except ValueError:
            raise InputError.expected("exposure", "auto, none or seconds", repr(wanted), "correct it") from None
    counts = Counter(source.info(k).exposure_s for k in range(len(source)))
    known = [seconds for seconds in counts if seconds is not None]
    # one exposure only: scaling all frames alike would change nothing but the unit
    if len(known) < 2:
        return None
    if None in counts:
        raise InputError.expected(
            "exposures of frames that differ",
            "that of every frame",
            f"{counts[None]} unknown",
            "complete the manifest, or leave exposures alone (exposure none)",
        )
    # the most frequent exposure leaves the most frames unscaled; of equal counts the longest, to be repeatable
    return max(known, key=lambda seconds: (counts[seconds], seconds))


def _white(
    white: NDArray[np.float32],
    dark: NDArray[np.float32] | float,
    recipe: CorrectionRecipe,
    cfa: str,
    saturation: float | None,
) -> White:
    if recipe.white_mode == "pixels":
        return White(white, dark, floor=recipe.white_floor, cfa=cfa, saturation=saturation)
    from lfcal.lattice import fit_lattice, vignetting_map

    try:
        field = vignetting_map(fit_lattice(white, dark=dark)).frame()
    except InputError as error:
        raise InputError(f"{error}; or divide by the white frame itself (white mode pixels)") from None
    return White(field, 0.0, floor=recipe.white_floor)


def _of_channel(source: FrameSource, frame: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the part of a calibration frame that belongs to ``source``, where that is a channel of a mosaic."""
    step, phase = source.metadata.pixel_step, source.metadata.channel_phase
    if phase is None or frame.shape == source.shape:
        return frame
    # the frame's own channel, cut out of the mosaic as `channel_source` does
    r0, c0 = phase
    return np.ascontiguousarray(frame[r0::step, c0::step])


def _black_level(source: FrameSource) -> float:
    """Return the black level of camera RAW frames, 0 where there is none."""
    levels = np.atleast_1d(np.asarray(source.metadata.black_level or 0.0, float))
    if np.ptp(levels) > 0:
        raise InputError.expected("black level of the colours", "one for all", levels.tolist(), "give a dark frame")
    return float(levels[0])


def _background(text: str) -> Background:
    if text in ("border", "plane"):
        return Background(text)
    try:
        return Background("constant", float(text))
    except ValueError:
        raise InputError.expected(
            "background", "none, border, plane or a number of counts", repr(text), "correct it"
        ) from None
