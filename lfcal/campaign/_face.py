"""The public names of `lfcal.campaign`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.campaign.adaptive import iter_adaptive
from lfcal.campaign.regions import iter_record_regions, read_regions
from lfcal.campaign.steps import Adapted, AdaptiveStep, Goal

__all__ = ["Adapted", "AdaptiveStep", "Goal", "iter_adaptive", "iter_record_regions", "read_regions"]
