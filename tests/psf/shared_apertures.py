"""Apertures that tests share: the same sum of the same H is judged in each inspection of it, and takes half of that."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import ArrayLike

from lfcal.psf.aperture import Aperture, fit
from lfcal.psf.aperture._verdict import EdgeVerdict

Answer = tuple[Aperture, EdgeVerdict | None]

KEPT: dict[tuple[bytes, tuple[int, ...], float], Answer] = {}


@contextmanager
def shared_apertures() -> Iterator[None]:
    """Keep what a depth-plane sum is found to show, by all that it depends on: its values and the footprint."""
    judged = fit.plane_verdict

    def once(depth_sum: ArrayLike, *, footprint_px: float = 0.0) -> Answer:
        values = np.asarray(depth_sum, np.float64)
        key = (values.tobytes(), values.shape, footprint_px)
        if key not in KEPT:
            KEPT[key] = judged(depth_sum, footprint_px=footprint_px)
        return KEPT[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit, "plane_verdict", once)
        yield
