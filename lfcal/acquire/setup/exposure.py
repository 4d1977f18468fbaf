"""Find an exposure time for each plane at which the image is bright, but not saturated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from lfcal.acquire._looking import Looker
from lfcal.acquire.control import Control
from lfcal.acquire.options import Options
from lfcal.acquire.schedule import Schedule
from lfcal.base import Clock, InputError, Work
from lfcal.camera import ScanPlan
from lfcal.devices import Rig

__all__ = ["iter_exposures", "suggest_exposure"]

TRIES = 12


def suggest_exposure(
    peak: float, exposure_s: float, *, black_level: float, max_value: float, target: float = 0.7
) -> float | None:
    """Return the exposure time (s) at which the peak is at the fraction ``target`` of the range above black.

    ``peak`` is the highest sample (counts) of a frame exposed for ``exposure_s`` (s). The range extends from
    ``black_level`` to ``max_value`` (counts).

    The result is None if the frame shows no light or is saturated, because its brightness is then unknown.

    Examples
    --------
    >>> from lfcal.acquire.setup import suggest_exposure
    >>> print(f"{suggest_exposure(2000, 0.01, black_level=0, max_value=4000):.3f} s")  # 70 % where 50 % were
    0.014 s
    >>> print(suggest_exposure(4000, 0.01, black_level=0, max_value=4000))  # saturated by an unknown amount
    None
    """
    if peak >= max_value or peak <= black_level:
        return None
    return exposure_s * target * (max_value - black_level) / (peak - black_level)


def iter_exposures(
    rig: Rig,
    plan: ScanPlan,
    *,
    target: float = 0.7,
    longest_s: float = 10.0,
    options: Options | None = None,
    control: Control | None = None,
) -> Work[tuple[float, ...]]:
    """Measure a suitable exposure time (s) for every plane, from frames at four positions within one period.

    Nothing is recorded, and the stage returns to its previous position. The positions are a corner and the centre of a
    cell of one period, and the midpoints of two of its sides. At the returned exposure time, the peak at the brightest
    position is at the fraction ``target`` of the range from the black level to saturation. It is lower if ``longest_s``
    limits the exposure time.

    Parameters
    ----------
    rig, plan, options, control
        As in `lfcal.acquire.iter_record`.
    target
        Fraction of the range that the brightest peak uses.
    longest_s
        Longest exposure time (s).

    Raises
    ------
    InputError
        If a plane is dark even at ``longest_s`` (s), or saturated at every exposure time.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire.setup import iter_exposures
    >>> from lfcal.base import drain
    >>> (seconds,) = drain(iter_exposures(simulated_rig(plan), plan, target=0.7))
    >>> print(f"{seconds:.2f} s bring the brightest pixel to 70 % of full scale")
    0.02 s bring the brightest pixel to 70 % of full scale
    """
    options, control = options or Options(), control or Control()
    schedule = Schedule.of(plan, Options(margin_px=options.margin_px))
    nz, ny, nx = plan.shape[:3]
    places = np.array([[0, 0], [ny // 2, nx // 2], [0, nx // 2], [ny // 2, 0]])
    positions = np.column_stack([np.repeat(np.arange(nz), len(places)), np.tile(places, (nz, 1))])
    targets = plan.stage_um(positions)
    suggest = partial(
        suggest_exposure, black_level=plan.camera.sensor.black_level, max_value=rig.camera.max_value, target=target
    )
    clock = Clock("exposures", nz)
    found = []
    with Looker(rig, plan, options, control, targets=targets, roi=schedule.roi) as looker:
        for z in range(nz):
            yield clock.at(z)
            seconds = plan.exposures[z]
            for x, y, depth in targets[z * len(places) : (z + 1) * len(places)].tolist():
                looker.go((x, y, depth))
                suggestion = _settle(looker, seconds, suggest, rig.camera.max_value, longest_s)
                if suggestion is None:
                    raise InputError.expected(
                        f"plane z={z} ({plan.depths_um[z]:g} µm)",
                        "light within the camera's range",
                        "light that is too weak or too strong at every exposure",
                        "change the lamp or the iris",
                    )
                # the brightest position of a plane decides; the first is only a start of the search
                seconds = min(seconds, suggestion) if (x, y, depth) != tuple(targets[z * len(places)]) else suggestion
            found.append(seconds)
    yield clock.at(nz)
    return tuple(found)


def _settle(
    looker: Looker, seconds: float, suggest: Callable[[float, float], float | None], max_value: int, longest_s: float
) -> float | None:
    """Return the exposure (s) for the current position of the stage; None if there is none."""
    for _ in range(TRIES):
        peak = float(looker.expose(seconds).max())
        better = suggest(peak, seconds)
        if better is None:  # saturated or dark: the factor is unknown
            better = seconds / 4 if peak >= max_value else seconds * 8
        elif 0.5 < better / seconds < 2:
            return min(better, longest_s)
        if not 1e-6 < better <= longest_s * 8:
            return None
        seconds = min(better, longest_s)
    return None
