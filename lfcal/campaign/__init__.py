"""What needs both recording and fit.

- ``patterns``: the patterns of a session as a fit takes them
- ``adaptive``: record, fit, choose the next positions, until the error of H is as small as wanted
"""

from lfcal.campaign.adaptive import Adapted, AdaptiveStep, Goal, iter_adaptive

__all__ = ["Adapted", "AdaptiveStep", "Goal", "iter_adaptive"]
