"""Run commands as a user does."""

from __future__ import annotations

from tests.cli.conftest import lfcal

__all__ = ["lfcal"]
