"""A tiny H on disk, and what a fit of it finds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from lfcal.base import drain
from lfcal.psf import PSFMatrix, save
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.h.model_fit import FitSettings
from lfcal_gui.pages.h.model_fit_run import FitRun, asked_of, iter_fit
from tests.fit.common import few_patterns

GEOMETRY = FitSettings(auto=False, groups=("geometry",))


def saved(path: Path, matrix: PSFMatrix | None = None) -> Path:
    save(few_patterns() if matrix is None else matrix, path)
    return path


def project_of(path: Path, settings: FitSettings = GEOMETRY) -> ProjectState:
    state = replace(ProjectState(), psf=str(path))
    return replace(state, settings=settings.into(state))


def fit_of(path: Path) -> FitRun:
    """Return what a fit of an H tells and finds."""
    kept = FitRun()
    drain(iter_fit(asked_of(project_of(path), GEOMETRY), kept))
    assert kept.found is not None
    return kept


@cache
def with_outlier() -> PSFMatrix:
    """Return the H with one pattern that is not like the others."""
    H = few_patterns()
    values = np.array(H)
    z, y, x = np.argwhere(H.recorded > 0)[2]
    values[z, y, x] = 0.8 * values[z, y, x] + 0.2 * np.roll(values[z, y, x], 3, axis=0)
    return PSFMatrix(values, depths=H.depths, camera=H.camera, anchor=H.anchor, facts=H.facts)
