"""Backends of real devices, one module each; `lfcal.devices.registry` finds them by name."""
