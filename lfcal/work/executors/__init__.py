"""Who does the units of a run; found by a registry, others by the entry point ``lfcal.executors``."""

from __future__ import annotations

from lfcal.registry import Registry
from lfcal.work.executors.base import ExecutorKind

__all__ = ["EXECUTORS"]

EXECUTORS: Registry[ExecutorKind] = Registry("executor", __name__, "EXECUTOR", "lfcal.executors")
"""All executors by name."""
