"""Names of `lfcal_gui.models` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal_gui.models.autosave import Claim, UnsavedCopy, find_kept, keep
from lfcal_gui.models.display import (
    COLOUR_MAPS,
    DIVERGING,
    SCALES,
    DisplaySettings,
    colour_table,
    depth_colours,
    levels_of,
    shades,
    tinted,
    to_uint8,
)
from lfcal_gui.models.doctor import doctor_html, doctor_text
from lfcal_gui.models.filling import Filling
from lfcal_gui.models.fitted import FittedCamera
from lfcal_gui.models.form import Field, parse, text_of
from lfcal_gui.models.frame_view import FrameNumbers, frame_numbers, lattice_points, render_tile, visible_tile
from lfcal_gui.models.history import History, Taken
from lfcal_gui.models.job import JobState, Keeping, WindowJob
from lfcal_gui.models.job_log import JobLog, notes_of, warnings_to
from lfcal_gui.models.kept_run import KeptRun, going_on, stamp_of_files
from lfcal_gui.models.manual import ATLAS, manual_folder, section_of
from lfcal_gui.models.measure import line_profile, region_numbers, sampled, value_histogram
from lfcal_gui.models.mishaps import Mishap, Mishaps, safe_words
from lfcal_gui.models.opening import OpeningSettings, stated_order
from lfcal_gui.models.page import (
    PAGES,
    PLACES,
    available_pages,
    file_state,
    found_state,
    nothing,
    page_states,
    place_words,
    with_found,
)
from lfcal_gui.models.project import Hold, Project, ProjectState, RecentProjects, read_project
from lfcal_gui.models.record_form import check_of, fields_of, options_in, shown_of, text_in_form, value_in
from lfcal_gui.models.shot import CUTOUT, Label, Levels, Outline, Overlay, Shot, Symbols, Tint, cutout_of, scale_bar
from lfcal_gui.models.solid import BEGIN, Projection, Solid, Viewpoint, project_solid, turned
from lfcal_gui.models.stamp import Stamp, stamp_of
from lfcal_gui.models.step import CAMERA_FILE, PLAN_FILE, CommandStep, needed_file, needed_plan, options_of, step_of
from lfcal_gui.models.words import plane_words, said_in_window, typeset, unbroken

__all__ = [
    "ATLAS",
    "BEGIN",
    "CAMERA_FILE",
    "COLOUR_MAPS",
    "CUTOUT",
    "DIVERGING",
    "PAGES",
    "PLACES",
    "PLAN_FILE",
    "SCALES",
    "Claim",
    "CommandStep",
    "DisplaySettings",
    "Field",
    "Filling",
    "FittedCamera",
    "FrameNumbers",
    "History",
    "Hold",
    "JobLog",
    "JobState",
    "Keeping",
    "KeptRun",
    "Label",
    "Levels",
    "Mishap",
    "Mishaps",
    "OpeningSettings",
    "Outline",
    "Overlay",
    "Project",
    "ProjectState",
    "Projection",
    "RecentProjects",
    "Shot",
    "Solid",
    "Stamp",
    "Symbols",
    "Taken",
    "Tint",
    "UnsavedCopy",
    "Viewpoint",
    "WindowJob",
    "available_pages",
    "check_of",
    "colour_table",
    "cutout_of",
    "depth_colours",
    "doctor_html",
    "doctor_text",
    "fields_of",
    "file_state",
    "find_kept",
    "found_state",
    "frame_numbers",
    "going_on",
    "keep",
    "lattice_points",
    "levels_of",
    "line_profile",
    "manual_folder",
    "needed_file",
    "needed_plan",
    "notes_of",
    "nothing",
    "options_in",
    "options_of",
    "page_states",
    "parse",
    "place_words",
    "plane_words",
    "project_solid",
    "read_project",
    "region_numbers",
    "render_tile",
    "safe_words",
    "said_in_window",
    "sampled",
    "scale_bar",
    "section_of",
    "shades",
    "shown_of",
    "stamp_of",
    "stamp_of_files",
    "stated_order",
    "step_of",
    "text_in_form",
    "text_of",
    "tinted",
    "to_uint8",
    "turned",
    "typeset",
    "unbroken",
    "value_histogram",
    "value_in",
    "visible_tile",
    "warnings_to",
    "with_found",
]
