"""Names of `lfcal.frames.corrections` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.frames.corrections._corrected import CorrectedSource, corrected
from lfcal.frames.corrections._pixel_map import frame_map
from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.corrections.defects import Defects, find_defects, iter_find_defects, repair_nan
from lfcal.frames.corrections.recipe import (
    check_turned_colours,
    corrected_view,
    first_image,
    read_average,
)
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
from lfcal.records import CorrectionRecipe

__all__ = [
    "Background",
    "CorrectedSource",
    "CorrectionChain",
    "CorrectionRecipe",
    "Dark",
    "DarkSet",
    "Defects",
    "Exposure",
    "PixelMask",
    "White",
    "average_frames",
    "check_turned_colours",
    "corrected",
    "corrected_view",
    "difference_variance",
    "find_defects",
    "first_image",
    "frame_map",
    "iter_find_defects",
    "read_average",
    "repair_nan",
]
