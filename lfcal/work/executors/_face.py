"""The public names of `lfcal.work.executors`, loaded when the first of them is used."""

from __future__ import annotations

from lfcal.work.executors.base import EXECUTORS

__all__ = ["EXECUTORS"]
