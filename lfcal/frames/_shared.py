"""Names of `lfcal.frames` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.frames.aligned import chosen_shift, find_shift
from lfcal.frames.cfa import cfa_from, check_cfa, pattern_side
from lfcal.frames.channels import OneColourSource, ThinnedSource, colour_scan, colours_of
from lfcal.frames.damage import SelectedSource, frame_errors
from lfcal.frames.described import stated_noise
from lfcal.frames.formats import split_dataset
from lfcal.frames.half_cell import with_partners
from lfcal.frames.opening import COMPONENTS, RECORDINGS, SOURCES, TABLES, datasets_in, files_of, open_component
from lfcal.frames.orientation import AUTO, CHECK
from lfcal.frames.part import (
    binned,
    check_inside,
    check_stated,
    is_part_of_sensor,
    parse_origin,
    part_refusal,
    stated_origin,
)
from lfcal.frames.positions import natural_key
from lfcal.frames.recorded import recorded_times
from lfcal.frames.source import check_index
from lfcal.frames.view import SourceView
from lfcal.frames.white_orientation import TurnedWhite, compared_orientations

__all__ = [
    "AUTO",
    "CHECK",
    "COMPONENTS",
    "RECORDINGS",
    "SOURCES",
    "TABLES",
    "OneColourSource",
    "SelectedSource",
    "SourceView",
    "ThinnedSource",
    "TurnedWhite",
    "binned",
    "cfa_from",
    "check_cfa",
    "check_index",
    "check_inside",
    "check_stated",
    "chosen_shift",
    "colour_scan",
    "colours_of",
    "compared_orientations",
    "datasets_in",
    "files_of",
    "find_shift",
    "frame_errors",
    "is_part_of_sensor",
    "natural_key",
    "open_component",
    "parse_origin",
    "part_refusal",
    "pattern_side",
    "recorded_times",
    "split_dataset",
    "stated_noise",
    "stated_origin",
    "with_partners",
]
