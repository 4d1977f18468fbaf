"""Searches of the Multiplexing page: filters and masks with the largest gain that can be made. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.base import Clock, Work
from lfcal.camera import Sensor
from lfcal.multiplex import Design, best_array, best_printed_mask, camera_chi2
from lfcal_gui.pages.multiplex.model import MultiplexSettings


@dataclass(frozen=True, eq=False)
class FoundDesign:
    """What a search found: the design, chi^2 it was made for, and lines for people."""

    design: Design
    chi2: float
    words: tuple[tuple[str, str], ...]


def iter_search(settings: MultiplexSettings, sensor: Sensor) -> Work[FoundDesign]:
    """Search as a job."""
    clock = Clock("search", 1)
    yield clock.at(0, settings.sought)
    chi2 = camera_chi2(sensor, gain=settings.gain)
    if settings.sought == "mask":
        found = best_printed_mask(
            settings.search_size,
            chi2,
            levels=settings.levels,
            crosstalk=settings.crosstalk,
            least_light=settings.least_light,
            starts=4,
        )
    else:
        side = (2, 3) if settings.sought.endswith("3") else (2, 2)
        letters = "RGBCMYW" if settings.crosstalk == 0 or side == (2, 2) else "RGBCMY"
        found = best_array(
            side,
            chi2,
            letters=letters,
            crosstalk=settings.crosstalk,
            most_kinds=settings.kinds,
            least_light=settings.least_light,
        )
    yield clock.at(1)
    return FoundDesign(found, chi2, _words(found, settings, chi2))


def _words(found: Design, settings: MultiplexSettings, chi2: float) -> tuple[tuple[str, str], ...]:
    over = "a pinhole" if settings.sought == "mask" else "Bayer"
    light = float(found.modulator.matrix.mean(0).mean())
    return (
        ("Best", found.modulator.name.replace("_", " ")),
        (f"Gain over {over}", f"{found.gain_db:+.3f} dB at χ² = {chi2:.4g}"),
        ("How sure", found.certificate),
        ("Tried", f"{found.tried}"),
        ("Transmission τ", f"{light:.4g}"),
    )
