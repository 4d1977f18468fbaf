"""Correction chains built from the user's settings, for the command line and the window."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, StorageError, check_choice, format_count, format_pixels
from lfcal.camera import ScanPlan
from lfcal.frames.aligned import ShiftedSource, shifted
from lfcal.frames.channels import ChannelSource, are_cutouts
from lfcal.frames.corrections._corrected import CorrectedSource
from lfcal.frames.corrections._pixel_map import sensor_map
from lfcal.frames.corrections.chain import CorrectionChain, Step
from lfcal.frames.corrections.defects import Defects, find_defects
from lfcal.frames.corrections.steps import (
    Background,
    Dark,
    DarkSet,
    Exposure,
    PixelMask,
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
    """Return a view of ``source`` whose frames are corrected as ``recipe`` states when they are read.

    Parameters
    ----------
    source
        Raw frames.
    recipe
        The corrections to apply.
    plan
        Scan plan that states bit depth, black level, exposures and colour filter if the frames do not.

    Raises
    ------
    InputError
        If a requested correction cannot be applied to these frames.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> with open_frames("session/frames") as source:
    ...     view = corrected_view(source, CorrectionRecipe(dark="session/dark"))
    ...     print(np.median(source.read(0)), abs(np.median(view.read(0)).round()))
    64.0 0.0
    """
    # first the samples, then their meaning, then their selection: each view reads the metadata of the previous one
    view = ShiftedSource(source, recipe.shift) if recipe.shift else source
    _check_levels(source, recipe)
    if plan is not None:
        view = DescribedSource(view, plan)
    if recipe.channel:
        view = ChannelSource(view, recipe.channel, plan.camera.sensor.cfa if plan is not None else "")
    return CorrectedSource(view, build_chain(view, recipe))


def check_turned_colours(frames: FrameSource, plan: ScanPlan, recipe: CorrectionRecipe, applied: str) -> None:
    """Raise `InputError` if frames are rotated, but their colour filter pattern is known only for the upright sensor.

    Nothing is raised if ``recipe`` treats all colours alike.

    Parameters
    ----------
    frames
        Frames as delivered, before corrections.
    plan
        Plan of the scan, whose sensor may have a colour filter.
    recipe
        The corrections, some of which treat colours separately.
    applied
        Name of the orientation that is applied to make the frames upright.

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
    colour pattern of rotated frames: expected the pattern of the frames as delivered, ...
    """
    used = recipe.channel or recipe.defects or recipe.white
    if applied == AS_IS or not used or frames.metadata.cfa or not plan.camera.sensor.cfa:
        return
    raise InputError.expected(
        "colour pattern of rotated frames",
        "the pattern of the frames as delivered",
        f"only that of the plan's upright sensor, {plan.camera.sensor.cfa}",
        "state it in the manifest, or rotate the files themselves",
    )


def read_average(path: str | os.PathLike[str], *, colour: str | None = None, shift: int = 0) -> NDArray[np.float32]:
    """Return the mean of all pages of an image file, or of all images in a folder, ``(rows, columns)`` float32.

    ``colour`` is as in `open_image`. Samples are first shifted right by ``shift`` bits.

    Raises
    ------
    LfcalError
        If there is no image, or one cannot be read or has another shape.
    """
    return _read_mean(path, colour, shift)[0]


def first_image(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` if it is a file, or the first image in the folder ``path``, in the order of names.

    Raises
    ------
    InputError
        If the folder contains no image.
    StorageError
        If ``path`` does not exist.
    """
    return _images(Path(path))[0]


def _images(place: Path) -> list[Path]:
    """Return the sorted images of a folder, or the single file ``place``."""
    if place.is_dir():
        # sorted, so that the float sums and with them the checksums do not depend on the folder's order
        files = sorted(p for p in place.iterdir() if p.suffix.lower() in image_suffixes())
        if not files:
            raise InputError.expected(
                f"calibration frames in {place}", "at least one image", "none", "choose the folder that contains them"
            )
        return files
    if not split_dataset(place)[0].exists():
        raise StorageError(f"{place}: no such file or folder; check the path")
    return [place]


def _read_mean(
    path: str | os.PathLike[str], colour: str | None, shift: int
) -> tuple[NDArray[np.float32], int, float | None]:
    """Return the mean of frames, their number (0: they may be means themselves), and the variance of a sample.

    The variance is estimated from successive frames; None for a single frame.
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
    # whole numbers are single exposures; floats are averages of an unknown number of frames
    return mean, len(counts) if all(counts) else 0, float(np.mean(variances)) if variances else None


def _pages(path: Path, colour: str | None) -> list[NDArray[Any]]:
    image = open_image(path, colour=colour)
    try:
        return [image.read(page) for page in range(image.pages)]
    finally:
        image.close()


def _check_levels(source: FrameSource, recipe: CorrectionRecipe) -> None:
    """Raise `InputError` for a level that no sample can reach; levels refer to samples after the shift."""
    if source.dtype.kind != "u":
        return
    most = (1 << (8 * source.dtype.itemsize - recipe.shift)) - 1
    for name, level in (("black level", recipe.black_level), ("saturation", recipe.saturation)):
        if level is not None and level > most:
            after = f" after a shift by {recipe.shift} bits" if recipe.shift else ""
            what = f"give {level / (1 << recipe.shift):g}" if recipe.shift else "give a value in this range"
            raise InputError.expected(name, f"at most {most}, the largest sample{after}", f"{level:g}", what)


def build_chain(source: FrameSource, recipe: CorrectionRecipe) -> CorrectionChain:
    """Return the correction chain of ``recipe`` for the frames of ``source``.

    If the frames show one channel of a mosaic, the same channel of the dark and white mosaics is used.

    Raises
    ------
    InputError
        If a requested correction cannot be applied to these frames.
    """
    known = source.metadata
    dark = _dark(source, recipe)
    steps: list[Step] = [] if dark is None else [dark]
    if recipe.white:
        check_choice("white correction", recipe.white_mode, ("field", "pixels"))
        white = _of_channel(source, read_average(recipe.white, colour=known.colour, shift=recipe.shift))
        saturation = recipe.saturation if recipe.saturation is not None else known.saturation
        steps.append(_white(white, _white_dark(dark, white.shape), recipe, known.cfa, saturation))
    shape = next((step.shape for step in steps if step.shape is not None), None)
    lost = sensor_map(recipe.mask, "mask", source, shape) if recipe.mask else None
    if lost is not None:
        steps.insert(0, PixelMask(lost))
    listed = sensor_map(recipe.defect_list, "defect pixels", source, shape) if recipe.defect_list else None
    defects = _defects(source, recipe.defects, listed, lost)
    steps += [] if defects is None else [defects]
    if recipe.background != "none":
        steps.append(_background(recipe.background))
    reference = _reference_exposure(source, recipe.exposure)
    if reference is not None:
        steps.append(Exposure(reference))
    return CorrectionChain(tuple(steps), saturation=recipe.saturation)


def _defects(
    source: FrameSource, search: bool, listed: NDArray[np.bool_] | None, lost: NDArray[np.bool_] | None
) -> Defects | None:
    """Return the listed defective pixels and, if requested, those found in the frames; None without either."""
    found = None
    if search:
        # the search compares one position of the sensor over all frames; cutouts are at different positions
        if are_cutouts(source):
            raise InputError.expected(
                "search for defect pixels", "whole sensor frames", "cutouts", "record whole frames for the search"
            )
        known = [one for one in (listed, lost) if one is not None]
        found = find_defects(source, ignore=np.logical_or.reduce(known) if known else None)
    if listed is None:
        return found
    pixels, kinds = np.argwhere(listed), ("listed",) * int(listed.sum())
    if found is not None:
        pixels, kinds = np.concatenate([pixels, np.asarray(found.pixels)]), (*kinds, *found.kinds)
    return Defects(pixels, (listed.shape[0], listed.shape[1]), source.metadata.cfa, kinds)


def _dark(source: FrameSource, recipe: CorrectionRecipe) -> Dark | DarkSet | None:
    """Return the dark step from the recipe, the recording, or else the black level; None without any."""
    if recipe.dark and recipe.dark != "none":
        if recipe.black_level is not None:
            got = f"both ({recipe.dark} and {recipe.black_level:g})"
            raise InputError.expected("black level", "a dark frame or a number", got, "omit one of them")
        frame, count, variance = _read_mean(recipe.dark, source.metadata.colour, recipe.shift)
        return Dark(_of_channel(source, frame), count=count, variance=variance)
    if recipe.black_level is None and recipe.dark == "none":
        return None
    darks, lost = source.metadata.darks, source.metadata.lost_darks
    if lost and recipe.black_level is None:
        raise InputError.expected(
            "recorded dark frames",
            f"intact dark frames of {', '.join(f'{seconds:g}' for seconds in lost)} s exposure",
            "damaged ones",
            "record them again (lfcal acquire --resume), or give other dark frames or the black level "
            "(--dark, --black-level)",
        )
    if darks and recipe.black_level is None:
        return DarkSet(darks)
    if recipe.black_level is not None:
        return Dark(level=recipe.black_level)  # also 0, which states that there is none
    level = _black_level(source)
    return Dark(level=level) if level else None


def _white_dark(dark: Dark | DarkSet | None, shape: tuple[int, ...]) -> NDArray[np.float32] | float:
    """Return the dark subtracted from the white image."""
    if dark is None:
        return 0.0
    one = dark.at(None) if isinstance(dark, DarkSet) and len(dark.darks) == 1 else dark
    if isinstance(one, DarkSet):
        known = ", ".join(f"{seconds:g}" for seconds in sorted(one.darks))
        raise InputError.expected(
            "dark frame for the white image",
            "a single dark frame",
            f"those of several exposures ({known} s)",
            "give one dark frame for all frames (--dark), or leave the white image out (--white)",
        )
    if one.frame is not None and one.frame.shape != shape:
        raise InputError.expected(
            "dark frame for the white image",
            format_pixels(shape),
            format_pixels(one.frame.shape),
            "record the dark frame on the same part of the sensor",
        )
    return one.level if one.frame is None else one.frame


def _reference_exposure(source: FrameSource, wanted: str) -> float | None:
    """Return the exposure to which frames are scaled (s), or None for no scaling."""
    if wanted == "none":
        return None
    if wanted != "auto":
        try:
            return float(wanted)
        except ValueError:
            raise InputError.expected(
                "exposure", "auto, none or seconds", repr(wanted), "write one of these words, or a number"
            ) from None
    counts = Counter(source.info(k).exposure_s for k in range(len(source)))
    known = [seconds for seconds in counts if seconds is not None]
    # a single exposure: scaling all frames would only change the unit
    if len(known) < 2:
        return None
    if None in counts:
        raise InputError.expected(
            "exposures of the frames",
            "an exposure for every frame, because exposures differ",
            format_count(counts[None], "frame without one", "frames without one"),
            "add the missing exposures to the manifest or list of the frames, or do not scale by exposure "
            "(--exposure none)",
        )
    # the most frequent exposure leaves most frames unscaled; among equal counts take the longest, for reproducibility
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
        raise InputError(f"{error}, or divide by the pixels of the white frame itself (--white-mode pixels)") from None
    return White(field, 0.0, floor=recipe.white_floor)


def _of_channel(source: FrameSource, frame: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the channel of a calibration frame that ``source`` shows, or else the frame unchanged."""
    step, phase = source.metadata.pixel_step, source.metadata.channel_phase
    if phase is None or frame.shape == source.shape:
        return frame
    # the channel of the calibration frame, extracted as in `channel_source`
    r0, c0 = phase
    return np.ascontiguousarray(frame[r0::step, c0::step])


def _black_level(source: FrameSource) -> float:
    """Return the black level that the frames state, or 0 if they state none; refuse one that differs by colour."""
    levels = np.atleast_1d(np.asarray(source.metadata.black_level or 0.0, float))
    if np.ptp(levels) > 0:
        raise InputError.expected(
            "black level", "one level for all colours", levels.tolist(), "give a dark frame instead"
        )
    return float(levels[0])


def _background(text: str) -> Background:
    if text in ("border", "plane"):
        return Background(text)
    try:
        return Background("constant", float(text))
    except ValueError:
        raise InputError.expected(
            "background",
            "none, border, plane or a number of counts",
            repr(text),
            "write one of these words, or a number",
        ) from None
