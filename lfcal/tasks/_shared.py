"""Names of `lfcal.tasks` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.tasks._channels import ChannelPart
from lfcal.tasks._patterns import most_taken
from lfcal.tasks.acquire import PlannedSession, RecordedSession
from lfcal.tasks.assembly import Assembled, AssemblyRun
from lfcal.tasks.cameras import (
    OF_NOISE,
    OF_RAW_NOISE,
    OF_WEIGHTS,
    assumed_in_words,
    load_camera,
    load_file,
    note_assumed,
)
from lfcal.tasks.depth import DepthForecast, MeasuredDepth
from lfcal.tasks.export import ExportedFiles
from lfcal.tasks.fit import FitOutcome, FittedPatterns
from lfcal.tasks.fit_check import CheckedMatrix
from lfcal.tasks.fit_frames import Recalibrated
from lfcal.tasks.fit_object import PredictedObject
from lfcal.tasks.fit_validate import Validated
from lfcal.tasks.inspect import InspectedMatrix
from lfcal.tasks.matrices import check_mat_files, open_matrix
from lfcal.tasks.outputs import check_output, check_outputs
from lfcal.tasks.plan import PLAN_FORMATS, plan_text
from lfcal.tasks.plan_fit import PositionsPlanned
from lfcal.tasks.plan_target import TargetPlanned
from lfcal.tasks.planned import WITHOUT_READOUT, Planned, planned_scan
from lfcal.tasks.reconstruct import FittedFeatures, Reconstructed, ReconstructedBars, ReconstructionForecast
from lfcal.tasks.reduce import ReducedFile
from lfcal.tasks.sets import task_set
from lfcal.tasks.simulate import SimulatedH, SimulatedRegions, SimulationForecast
from lfcal.tasks.target_frames import left_words
from lfcal.tasks.task import Task, TaskSet, may_replace
from lfcal.tasks.text import load_job, words_of
from lfcal.tasks.transpose import TransposedFile
from lfcal.tasks.watch import Watched

__all__ = [
    "OF_NOISE",
    "OF_RAW_NOISE",
    "OF_WEIGHTS",
    "PLAN_FORMATS",
    "WITHOUT_READOUT",
    "Assembled",
    "AssemblyRun",
    "ChannelPart",
    "CheckedMatrix",
    "DepthForecast",
    "ExportedFiles",
    "FitOutcome",
    "FittedFeatures",
    "FittedPatterns",
    "InspectedMatrix",
    "MeasuredDepth",
    "Planned",
    "PlannedSession",
    "PositionsPlanned",
    "PredictedObject",
    "Recalibrated",
    "Reconstructed",
    "ReconstructedBars",
    "ReconstructionForecast",
    "RecordedSession",
    "ReducedFile",
    "SimulatedH",
    "SimulatedRegions",
    "SimulationForecast",
    "TargetPlanned",
    "Task",
    "TaskSet",
    "TransposedFile",
    "Validated",
    "Watched",
    "assumed_in_words",
    "check_mat_files",
    "check_output",
    "check_outputs",
    "left_words",
    "load_camera",
    "load_file",
    "load_job",
    "may_replace",
    "most_taken",
    "note_assumed",
    "open_matrix",
    "plan_text",
    "planned_scan",
    "task_set",
    "words_of",
]
