"""The lattice followed from the middle of the frame outwards, so that a distortion never loses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice._forms import DistortionFrame, LatticeForm, fit_form
from lfcal.lattice._model import LatticeModel
from lfcal.lattice._rounds import place_all
from lfcal.lattice._selection import flexible_form, thinned

__all__ = ["followed", "start_reach"]

START_PITCHES = 10.0
START_SHARE = 0.33
"""Radius of the first region, as a share of half the frame's diagonal."""

START_PX = 700.0
"""Largest first region (pixels): there the spectrum's lattice is right to a fraction of a pitch."""

GROWTH = 1.6
"""From one region to the next: a cubic runs ahead that far."""

MIN_REGION = 60
"""Lenslets of the first region, at least."""

TRACKING_DEGREE = 3
"""A higher order would run away from the measured region."""


def start_reach(model: LatticeModel, frame: DistortionFrame) -> float:
    """Return the radius of the first region (pixels)."""
    wanted = max(START_PITCHES * model.pitch, min(START_SHARE * frame.scale, START_PX))
    return wanted if 3 * (wanted / model.pitch) ** 2 >= MIN_REGION else frame.scale


def tracking_form(count: int) -> LatticeForm:
    """Return the form that runs ahead of ``count`` lenslets."""
    form = flexible_form(count // 2)
    return form if form.degree <= TRACKING_DEGREE else flexible_form(100)


def followed(image: NDArray[np.float32], model: LatticeModel, workers: int | None) -> LatticeModel:
    """Return the lattice fitted in growing regions, each placed about what the smaller one foretells."""
    frame = DistortionFrame.of(image.shape)
    reach = start_reach(model, frame)
    # the first region is placed twice: its start is the spectrum's alone
    reaches = [reach]
    while reaches[-1] < frame.scale:
        reaches.append(min(frame.scale, GROWTH * reaches[-1]))
    for near in [reaches[0], *reaches]:
        lenslets = place_all(image, model, workers, near)
        alive = np.flatnonzero(~lenslets.dead)
        alive = alive[thinned(len(alive))]
        form = tracking_form(len(alive))
        fitted = fit_form(model, form, lenslets.index[alive], lenslets.places[alive], frame)
        if fitted is not None:
            model = fitted.model
    return model
