"""Richardson-Lucy with total variation, one step late (Dey et al. 2006)."""

from __future__ import annotations

from lfcal.reconstruct.solvers._em import penalised
from lfcal.reconstruct.solvers.penalty import TotalVariation

__all__ = ["SOLVER"]

SOLVER = penalised("rl-tv", "Richardson-Lucy with total variation: less noise, edges kept", TotalVariation, rank=20)
