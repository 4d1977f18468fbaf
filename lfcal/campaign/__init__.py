"""What needs both recording and fit.

- ``patterns``: the patterns of a session as a fit takes them
- ``steps``: when such a session ends, what is known after each fit, how it ended
- ``regions``: several regions of the field in one session, and H of all of them in one file
- ``adaptive``: record, fit, choose the next positions, until the error of H is as small as wanted
"""

from lfcal.campaign.adaptive import iter_adaptive
from lfcal.campaign.regions import iter_record_regions, read_regions
from lfcal.campaign.steps import Adapted, AdaptiveStep, Goal

__all__ = ["Adapted", "AdaptiveStep", "Goal", "iter_adaptive", "iter_record_regions", "read_regions"]
