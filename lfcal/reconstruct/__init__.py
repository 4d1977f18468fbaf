"""Volume reconstruction: the projector pair and the solvers."""

from lfcal.reconstruct.projector import Projector

__all__ = ["Projector"]
