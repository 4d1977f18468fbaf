"""Backends of real devices, with one module for each; `lfcal.devices.registry` finds them by name."""
