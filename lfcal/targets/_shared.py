"""Names of `lfcal.targets` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.targets.display import pictures_in, write_pictures
from lfcal.targets.facts import facts_of_plan
from lfcal.targets.frames import frames_of, open_target_frames, read_target_plan
from lfcal.targets.images import whole_at
from lfcal.targets.offsets import covered_by
from lfcal.targets.phases import Phases, nearest_positions
from lfcal.targets.sampling import may_resample, resampling_words
from lfcal.targets.subsets import coding_verdict, display_words, planned_for_display
from lfcal.targets.target import proposed_hole

__all__ = [
    "Phases",
    "coding_verdict",
    "covered_by",
    "display_words",
    "facts_of_plan",
    "frames_of",
    "may_resample",
    "nearest_positions",
    "open_target_frames",
    "pictures_in",
    "planned_for_display",
    "proposed_hole",
    "read_target_plan",
    "resampling_words",
    "whole_at",
    "write_pictures",
]
