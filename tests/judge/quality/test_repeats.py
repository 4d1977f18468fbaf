"""Repeated frames of a position: their spread is a figure of quality, unknown where nothing was repeated."""

from __future__ import annotations

import numpy as np

from lfcal.judge import inspect
from lfcal.psf import Facts, PSFMatrix

from .faults import base
from .scenes import hexagonal


def test_spread_of_repeats_is_judged_and_unknown_without() -> None:
    scene = hexagonal()
    values = base(scene)
    nz, ny, nx, nt, ns = values.shape
    alone = inspect(PSFMatrix(values, depths=scene.depths))["repeatability"]
    assert alone.merit == "unknown" and np.isnan(alone.value)
    spread = np.full((nz, ny, nx), np.nan)
    spread[0, 3, :5] = 0.4  # five positions of the first plane were recorded twice, and differ
    facts = Facts.of((nz, ny, nx), (nt, ns), recorded=np.ones((nz, ny, nx)), spread=spread)
    found = inspect(PSFMatrix(values, depths=scene.depths, facts=facts))["repeatability"]
    assert found.merit == "bad" and np.isclose(found.value, 40.0)
    facts = Facts.of((nz, ny, nx), (nt, ns), spread=np.where(np.isnan(spread), np.nan, 0.02))
    assert inspect(PSFMatrix(values, depths=scene.depths, facts=facts))["repeatability"].merit == "good"
