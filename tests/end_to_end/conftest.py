"""Fixtures of the command line."""

from __future__ import annotations

from tests.cli.conftest import _fewest_patterns, _recorded, _shared_models, inputs, lfcal, session

__all__ = ["_fewest_patterns", "_recorded", "_shared_models", "inputs", "lfcal", "session"]
