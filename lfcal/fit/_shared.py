"""Names of `lfcal.fit` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.fit.compared import Compared
from lfcal.fit.design import PositionDesign, draw_design, iter_next_positions
from lfcal.fit.drawing import leftover_of
from lfcal.fit.earlier import Earlier, read_earlier
from lfcal.fit.expected import Behind, behind, plan_of
from lfcal.fit.field import FieldFit, FieldRegion, Regional, iter_fit_field
from lfcal.fit.field_files import field_dict, field_outputs, iter_write_field
from lfcal.fit.field_report import wavefront_table
from lfcal.fit.files import (
    CAMERA,
    EFFECTS,
    FORMAT,
    MODEL,
    NUMBERS,
    REPORT,
    fit_dict,
    fit_outputs,
    iter_write_fit,
    iter_write_model,
    json_text,
    measured_camera,
    write_found,
    write_text,
)
from lfcal.fit.fit import Finished, check_stage, groups_of, iter_retrieved, iter_summarised, problem_of
from lfcal.fit.holds import iter_check
from lfcal.fit.hybrid import HybridSummary
from lfcal.fit.information import Expected
from lfcal.fit.judge import ModelError, chi_square, covariance
from lfcal.fit.measured import HELD_OUT, QUICK_PATTERN, check_optics, of_quick_pattern
from lfcal.fit.model import Fineness, PlaneModel, predict
from lfcal.fit.normal import Columns, Local
from lfcal.fit.nuisance import Spread, nuisance_steps
from lfcal.fit.parameters import lacking
from lfcal.fit.problem import ERRORS, Problem
from lfcal.fit.questions import check_described, check_light
from lfcal.fit.report import add_picture, iter_fit_report
from lfcal.fit.select import GroupSelection, gain_of
from lfcal.fit.setup import RegionPlace, starting_effects, with_given
from lfcal.fit.solver import descend
from lfcal.fit.spread import spread_out
from lfcal.fit.stored import Filler, read_fit
from lfcal.fit.validate import PointError, Validation, draw_validation, iter_validate, predicted_frame

__all__ = [
    "CAMERA",
    "EFFECTS",
    "ERRORS",
    "FORMAT",
    "HELD_OUT",
    "MODEL",
    "NUMBERS",
    "QUICK_PATTERN",
    "REPORT",
    "Behind",
    "Columns",
    "Compared",
    "Earlier",
    "Expected",
    "FieldFit",
    "FieldRegion",
    "Filler",
    "Fineness",
    "Finished",
    "GroupSelection",
    "HybridSummary",
    "Local",
    "ModelError",
    "PlaneModel",
    "PointError",
    "PositionDesign",
    "Problem",
    "RegionPlace",
    "Regional",
    "Spread",
    "Validation",
    "add_picture",
    "behind",
    "check_described",
    "check_light",
    "check_optics",
    "check_stage",
    "chi_square",
    "covariance",
    "descend",
    "draw_design",
    "draw_validation",
    "field_dict",
    "field_outputs",
    "fit_dict",
    "fit_outputs",
    "gain_of",
    "groups_of",
    "iter_check",
    "iter_fit_field",
    "iter_fit_report",
    "iter_next_positions",
    "iter_retrieved",
    "iter_summarised",
    "iter_validate",
    "iter_write_field",
    "iter_write_fit",
    "iter_write_model",
    "json_text",
    "lacking",
    "leftover_of",
    "measured_camera",
    "nuisance_steps",
    "of_quick_pattern",
    "plan_of",
    "predict",
    "predicted_frame",
    "problem_of",
    "read_earlier",
    "read_fit",
    "spread_out",
    "starting_effects",
    "wavefront_table",
    "with_given",
    "write_found",
    "write_text",
]
