"""Live set-up: what a person needs to see before the session begins; no window in here.

- ``levels``: histogram of every pixel, exact saturation
- ``lfcal.acquire.spots``: where the spot is, how sharp, how far it moved
- ``stage_fit``: stage-to-image scale, rotation and sign from a few moves
- ``optical_axis``: where moving in depth does not move the image
- ``exposure``: exposure time for each plane
- ``live``: the live view, and where the plan expects the image
"""

from lfcal.acquire.setup.exposure import iter_exposures, suggest_exposure
from lfcal.acquire.setup.levels import Levels, levels
from lfcal.acquire.setup.live import LiveState, iter_live, predicted_image
from lfcal.acquire.setup.optical_axis import OpticalAxis, find_optical_axis, iter_optical_axis
from lfcal.acquire.setup.stage_fit import StageFit, check_stage, fit_stage, iter_stage_fit
from lfcal.acquire.spots import Spot, find_spot, image_shift

__all__ = [
    "Levels",
    "LiveState",
    "OpticalAxis",
    "Spot",
    "StageFit",
    "check_stage",
    "find_optical_axis",
    "find_spot",
    "fit_stage",
    "image_shift",
    "iter_exposures",
    "iter_live",
    "iter_optical_axis",
    "iter_stage_fit",
    "levels",
    "predicted_image",
    "suggest_exposure",
]
