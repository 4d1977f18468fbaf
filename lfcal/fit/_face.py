"""The public names of `lfcal.fit`: each is loaded on first use."""

from __future__ import annotations

from lfcal.fit.field import fit_field
from lfcal.fit.fit import FitProgress, fit_camera, iter_fit_camera
from lfcal.fit.locate import NewFrame
from lfcal.fit.measured import Measured, measured_of
from lfcal.fit.parameters import GROUPS, Group, Unknown
from lfcal.fit.result import Fit, Outlier, Parameter
from lfcal.fit.setup import Setup

__all__ = [
    "GROUPS",
    "Fit",
    "FitProgress",
    "Group",
    "Measured",
    "NewFrame",
    "Outlier",
    "Parameter",
    "Setup",
    "Unknown",
    "fit_camera",
    "fit_field",
    "iter_fit_camera",
    "measured_of",
]
