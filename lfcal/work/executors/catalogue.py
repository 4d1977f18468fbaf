"""All executors by name."""

from __future__ import annotations

from lfcal.base import Registry
from lfcal.work.executors.base import ExecutorKind

__all__ = ["EXECUTORS"]

EXECUTORS: Registry[ExecutorKind] = Registry("executor", "lfcal.work.executors", "EXECUTOR", "lfcal.executors")
"""All executors by name."""
