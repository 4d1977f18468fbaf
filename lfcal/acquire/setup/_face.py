"""The public names of `lfcal.acquire.setup`, loaded on first use."""

from __future__ import annotations

from lfcal.acquire.setup.exposure import iter_exposures, suggest_exposure
from lfcal.acquire.setup.live import Levels, LiveState, iter_live, levels, predicted_image
from lfcal.acquire.setup.optical_axis import OpticalAxis, find_optical_axis, iter_optical_axis
from lfcal.acquire.setup.stage_check import StageCheck, iter_stage_check
from lfcal.acquire.setup.stage_fit import StageFit, check_stage, fit_stage, iter_stage_fit
from lfcal.acquire.spots import Spot, find_spot, image_shift

__all__ = [
    "Levels",
    "LiveState",
    "OpticalAxis",
    "Spot",
    "StageCheck",
    "StageFit",
    "check_stage",
    "find_optical_axis",
    "find_spot",
    "fit_stage",
    "image_shift",
    "iter_exposures",
    "iter_live",
    "iter_optical_axis",
    "iter_stage_check",
    "iter_stage_fit",
    "levels",
    "predicted_image",
    "suggest_exposure",
]
