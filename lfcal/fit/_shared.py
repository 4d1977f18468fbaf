"""Names of `lfcal.fit` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.fit._frame_noise import DARK, noises_of
from lfcal.fit.compared import Compared, compared_with
from lfcal.fit.design import PositionDesign, draw_design, iter_next_positions
from lfcal.fit.deviations import iter_write_deviations
from lfcal.fit.drawing import leftover_of
from lfcal.fit.earlier import Earlier, read_earlier
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
)
from lfcal.fit.fit import Finished, check_stage, groups_of, iter_retrieved, iter_summarised, problem_of
from lfcal.fit.hybrid import HybridSummary
from lfcal.fit.information import Expected
from lfcal.fit.locate import LocatedPattern, find_source
from lfcal.fit.measured import HELD_OUT, QUICK_PATTERN, check_optics, kept_aside, of_quick_pattern
from lfcal.fit.model import Fineness, ModelPlanes, PlaneModel, predict
from lfcal.fit.model_error import ChiSquare, ModelError, chi_square, covariance
from lfcal.fit.normal import Columns, Local
from lfcal.fit.nuisance import Spread, nuisance_steps
from lfcal.fit.parameters import ScanScales, Vector, check_groups, lacking
from lfcal.fit.problem import ERRORS, STEP, STEP_PX, Problem
from lfcal.fit.questions import check_described, check_light
from lfcal.fit.report import iter_fit_report
from lfcal.fit.select import GroupSelection, gain_of
from lfcal.fit.setup import RegionPlace, described_effects, starting_effects, with_given
from lfcal.fit.solver import descend
from lfcal.fit.spread import spread_out
from lfcal.fit.stored import Filler, StoredFit, numbers_file, read_fit, read_fits
from lfcal.fit.validate import (
    Validation,
    iter_write_validation,
    predicted_frame,
    validation_outputs,
)

__all__ = [
    "CAMERA",
    "DARK",
    "EFFECTS",
    "ERRORS",
    "FORMAT",
    "HELD_OUT",
    "MODEL",
    "NUMBERS",
    "QUICK_PATTERN",
    "REPORT",
    "STEP",
    "STEP_PX",
    "ChiSquare",
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
    "LocatedPattern",
    "ModelError",
    "ModelPlanes",
    "PlaneModel",
    "PositionDesign",
    "Problem",
    "RegionPlace",
    "Regional",
    "ScanScales",
    "Spread",
    "StoredFit",
    "Validation",
    "Vector",
    "check_described",
    "check_groups",
    "check_light",
    "check_optics",
    "check_stage",
    "chi_square",
    "compared_with",
    "covariance",
    "descend",
    "described_effects",
    "draw_design",
    "field_dict",
    "field_outputs",
    "find_source",
    "fit_dict",
    "fit_outputs",
    "gain_of",
    "groups_of",
    "iter_fit_field",
    "iter_fit_report",
    "iter_next_positions",
    "iter_retrieved",
    "iter_summarised",
    "iter_write_deviations",
    "iter_write_field",
    "iter_write_fit",
    "iter_write_model",
    "iter_write_validation",
    "json_text",
    "kept_aside",
    "lacking",
    "leftover_of",
    "measured_camera",
    "noises_of",
    "nuisance_steps",
    "numbers_file",
    "of_quick_pattern",
    "predict",
    "predicted_frame",
    "problem_of",
    "read_earlier",
    "read_fit",
    "read_fits",
    "spread_out",
    "starting_effects",
    "validation_outputs",
    "wavefront_table",
    "with_given",
    "write_found",
]
