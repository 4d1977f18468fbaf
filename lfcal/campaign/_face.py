"""The public names of `lfcal.campaign`, loaded on first use."""

from __future__ import annotations

from lfcal.campaign.adaptive import Adapted, AdaptiveStep, Goal, iter_adaptive
from lfcal.campaign.regions import iter_record_regions, read_regions

__all__ = ["Adapted", "AdaptiveStep", "Goal", "iter_adaptive", "iter_record_regions", "read_regions"]
