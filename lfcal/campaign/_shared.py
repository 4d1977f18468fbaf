"""Names of `lfcal.campaign` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.campaign.point_assembly import iter_assemble_points, target_facts
from lfcal.campaign.point_fit import MOST, hole_words, iter_fit_points, iter_write_points, point_outputs
from lfcal.campaign.points import Points, iter_points_of
from lfcal.campaign.regions import (
    first_begun,
    forecast_regions,
    is_regions,
    region_sessions,
    save_parts,
    temporary_parts,
)
from lfcal.campaign.turned_frames import find_turned_frames, seen_patterns

__all__ = [
    "MOST",
    "Points",
    "find_turned_frames",
    "first_begun",
    "forecast_regions",
    "hole_words",
    "is_regions",
    "iter_assemble_points",
    "iter_fit_points",
    "iter_points_of",
    "iter_write_points",
    "point_outputs",
    "region_sessions",
    "save_parts",
    "seen_patterns",
    "target_facts",
    "temporary_parts",
]
