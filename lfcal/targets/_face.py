"""The public names of `lfcal.targets`, loaded on first use."""

from __future__ import annotations

from lfcal.targets.camera import TargetCamera, uneven
from lfcal.targets.coded import DecodedFrames, decoded
from lfcal.targets.display import Display, coded_plan, display_image, iter_plan_display, parse_display
from lfcal.targets.expected import ErrorForecast, error_forecast
from lfcal.targets.finding import FoundPoints, find_points
from lfcal.targets.plan import TargetForecast, TargetPlan
from lfcal.targets.planning import Wishes, iter_plan_target, plan_target, propose_target
from lfcal.targets.pose import Pose
from lfcal.targets.target import Target, parse_target, target_words

__all__ = [
    "DecodedFrames",
    "Display",
    "ErrorForecast",
    "FoundPoints",
    "Pose",
    "Target",
    "TargetCamera",
    "TargetForecast",
    "TargetPlan",
    "Wishes",
    "coded_plan",
    "decoded",
    "display_image",
    "error_forecast",
    "find_points",
    "iter_plan_display",
    "iter_plan_target",
    "parse_display",
    "parse_target",
    "plan_target",
    "propose_target",
    "target_words",
    "uneven",
]
