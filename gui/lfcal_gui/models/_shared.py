"""Names of `lfcal_gui.models` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal_gui.models.autosave import Claim, UnsavedCopy, find_kept, keep
from lfcal_gui.models.comparison import (
    COMPARED_COLUMNS,
    COMPARED_MODES,
    COMPARED_TIPS,
    Both,
    CompareRequest,
    KeptDifference,
    Place,
    both_at,
    compare_step,
    compared_files,
    compared_numbers,
    compared_rows,
    compared_words,
    differing_most,
    iter_compare,
    iter_compared,
    plane_of_row,
)
from lfcal_gui.models.cost import (
    ChartPoint,
    MeasuredCurves,
    asked_seconds,
    axis_labels,
    iter_measure,
    points_of,
    subject_of,
)
from lfcal_gui.models.display import (
    COLOUR_MAPS,
    DIVERGING,
    SCALES,
    DisplaySettings,
    colour_table,
    depth_colours,
    level_words,
    levels_of,
    shades,
    tinted,
    to_uint8,
)
from lfcal_gui.models.form import (
    UNKNOWN,
    Field,
    check_of,
    fields_of,
    means,
    options_in,
    parse,
    rounded,
    same,
    shown_of,
    text_in_form,
    text_of,
    value_in,
)
from lfcal_gui.models.frame_view import FrameNumbers, frame_numbers, lattice_points, render_tile, visible_tile
from lfcal_gui.models.gathering import (
    described,
    exported_to,
    filled_of,
    session_counts,
    sitting_of,
    with_checked,
    with_declined,
    with_described,
    with_exported,
)
from lfcal_gui.models.history import History, Taken
from lfcal_gui.models.job import (
    JobLog,
    JobState,
    Keeping,
    KeptRun,
    WindowJob,
    going_on,
    notes_of,
    stamp_of_files,
    warnings_to,
)
from lfcal_gui.models.manual import ATLAS, doctor_html, doctor_text, manual_folder, section_of
from lfcal_gui.models.measure import line_profile, region_numbers, sampled, value_histogram
from lfcal_gui.models.mishaps import Mishap, Mishaps, safe_words
from lfcal_gui.models.next_step import JOBS, Sitting, Step, next_step, rail_words
from lfcal_gui.models.pace import FORECASTS, Paces
from lfcal_gui.models.page import (
    PAGES,
    PLACES,
    available_pages,
    file_state,
    is_image,
    nothing,
    page_states,
)
from lfcal_gui.models.project import Hold, Project, ProjectState, RecentProjects, read_project
from lfcal_gui.models.remaking import Filling, WithoutBad, iter_made, new_file, shown_first, without_bad
from lfcal_gui.models.settings import OpeningSettings, ScanRates, stated_order
from lfcal_gui.models.shot import CUTOUT, Label, Levels, Outline, Overlay, Shot, Symbols, Tint, cutout_of, scale_bar
from lfcal_gui.models.solid import BEGIN, Projection, Solid, Viewpoint, project_solid, turned
from lfcal_gui.models.stamp import FittedCamera, Stamp, stamp_of
from lfcal_gui.models.step import (
    CAMERA_FILE,
    PLAN_FILE,
    CommandStep,
    list_beside,
    needed_file,
    needed_plan,
    options_of,
    step_of,
)
from lfcal_gui.models.verdict import Verdict, kept_verdict, verdict_of, with_verdict
from lfcal_gui.models.words import (
    SPACE,
    capital,
    minus,
    plane_words,
    rough_seconds,
    said_in_window,
    typeset,
    unbroken,
)
