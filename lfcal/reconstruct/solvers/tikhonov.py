"""Richardson-Lucy with the squared gradient as penalty, one step late (Tikhonov-Miller)."""

from __future__ import annotations

from lfcal.reconstruct.solvers._em import penalised
from lfcal.reconstruct.solvers.penalty import Tikhonov

__all__ = ["SOLVER"]

SOLVER = penalised("rl-tikhonov", "Richardson-Lucy with Tikhonov-Miller: less noise, softer", Tikhonov, rank=30)
