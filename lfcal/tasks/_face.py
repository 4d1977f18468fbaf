"""The public names of `lfcal.tasks`: each is loaded on first use."""

from __future__ import annotations

from lfcal.tasks.acquire import Acquire, AcquireRegions, AcquireTarget, AcquireUntil
from lfcal.tasks.assembly import Assemble, AssembleRegions, AssembleTarget, assemble
from lfcal.tasks.depth import Depth
from lfcal.tasks.export import ExportFor, ExportH5, ExportMat, ExportNpy, ExportTiff
from lfcal.tasks.fit import FitFrames, FitMatrix, FitTarget
from lfcal.tasks.fit_check import CheckMatrix, CheckMatrixByScan
from lfcal.tasks.fit_frames import Recalibrate
from lfcal.tasks.fit_object import PredictObject
from lfcal.tasks.fit_validate import ValidateFit, ValidateFitByFrames
from lfcal.tasks.inspect import Inspect
from lfcal.tasks.plan import PlanRecorded, PlanRegions, PlanScan
from lfcal.tasks.plan_fit import PlanFit
from lfcal.tasks.plan_target import PlanDisplay, PlanTarget
from lfcal.tasks.reconstruct import (
    Reconstruct,
    ReconstructBars,
    ReconstructFeatures,
    ReconstructForecast,
    ReconstructSeries,
    solver_settings,
)
from lfcal.tasks.reduce import Reduce
from lfcal.tasks.simulate import SimulateForecast, SimulateFrames, SimulateH, SimulatePasses, SimulateRegions
from lfcal.tasks.task import RunSettings
from lfcal.tasks.text import command_of, job_of, python_of
from lfcal.tasks.transpose import Transpose
from lfcal.tasks.watch import Watch

__all__ = [
    "Acquire",
    "AcquireRegions",
    "AcquireTarget",
    "AcquireUntil",
    "Assemble",
    "AssembleRegions",
    "AssembleTarget",
    "CheckMatrix",
    "CheckMatrixByScan",
    "Depth",
    "ExportFor",
    "ExportH5",
    "ExportMat",
    "ExportNpy",
    "ExportTiff",
    "FitFrames",
    "FitMatrix",
    "FitTarget",
    "Inspect",
    "PlanDisplay",
    "PlanFit",
    "PlanRecorded",
    "PlanRegions",
    "PlanScan",
    "PlanTarget",
    "PredictObject",
    "Recalibrate",
    "Reconstruct",
    "ReconstructBars",
    "ReconstructFeatures",
    "ReconstructForecast",
    "ReconstructSeries",
    "Reduce",
    "RunSettings",
    "SimulateForecast",
    "SimulateFrames",
    "SimulateH",
    "SimulatePasses",
    "SimulateRegions",
    "Transpose",
    "ValidateFit",
    "ValidateFitByFrames",
    "Watch",
    "assemble",
    "command_of",
    "job_of",
    "python_of",
    "solver_settings",
]
