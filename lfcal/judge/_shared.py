"""Names of `lfcal.judge` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.checking import iter_check
from lfcal.judge.dated import (
    DatedInspection,
    fits_in,
    inspection_of,
    inspections_in,
    labels_of,
    read_dated_fit,
    read_inspection,
)
from lfcal.judge.expected import behind, fitted_setup, plan_of
from lfcal.judge.inspection import is_bad, is_fair
from lfcal.judge.known_object import ObjectPlace, object_error
from lfcal.judge.new_frames import new_frame, new_frames
from lfcal.judge.pairing import Pair, pair
from lfcal.judge.region_loss import RegionLoss, draw_region_loss, iter_region_loss
from lfcal.judge.results import ListingProgress, ResultList, detailed
from lfcal.judge.source import Judged
from lfcal.judge.telling import compared_words, cost_words
from lfcal.judge.trend import TOO_SHORT, Course, CoursePoint, Trend, draw_trend, trend

__all__ = [
    "TOO_SHORT",
    "Course",
    "CoursePoint",
    "DatedInspection",
    "Judged",
    "ListingProgress",
    "ObjectPlace",
    "Pair",
    "RegionLoss",
    "ResultList",
    "Trend",
    "behind",
    "compared_words",
    "cost_words",
    "detailed",
    "draw_region_loss",
    "draw_trend",
    "fits_in",
    "fitted_setup",
    "inspection_of",
    "inspections_in",
    "is_bad",
    "is_fair",
    "iter_check",
    "iter_region_loss",
    "labels_of",
    "new_frame",
    "new_frames",
    "object_error",
    "pair",
    "plan_of",
    "read_dated_fit",
    "read_inspection",
    "trend",
]
