"""The simulator, listed with the other backends."""

from lfcal.devices.simulated import SimBackend

__all__ = ["BACKEND"]

BACKEND = SimBackend()
