"""A measurement in words: one line a figure."""

from __future__ import annotations

from lfcal.frames.photon_transfer.result import SensorMeasurement
from lfcal.frames.photon_transfer.values import Measured

__all__ = ["figures_of"]


def figures_of(found: SensorMeasurement) -> list[tuple[str, str]]:
    """Return name and value with its error and unit of every figure; "unknown" where it could not be told."""
    channels = [(f"  {name}", _text(gain, "counts per e⁻")) for name, gain in found.channels.items()]
    return [
        ("gain", _text(found.gain, "counts per e⁻")),
        ("", _text(found.electrons_per_count, "e⁻ per count")),
        *channels,
        ("black level", _text(found.black_level, "counts")),
        ("read noise", _text(found.read_noise_e, "e⁻ rms")),
        ("", _text(found.read_noise_counts, "counts rms")),
        ("saturated from", _text(found.saturation, "counts")),
        ("full well", _text(found.full_well_e, "e⁻")),
        ("departure from linearity", _text(_percent(found.linearity), "% at most")),
        ("pixel response (PRNU)", _text(_percent(found.prnu), "% rms")),
        ("offsets (DSNU)", _text(found.dsnu_e, "e⁻ rms")),
        ("dark current", _text(found.dark_current_e_s, "e⁻/s")),
        ("bits in use", f"{found.bits}" + (f", left-aligned by {found.shift}" if found.shift else "")),
        ("hot and dead pixels", f"{found.hot}, {found.dead}"),
    ]


def _percent(value: Measured | None) -> Measured | None:
    return None if value is None else value.times(100.0)


def _text(value: Measured | None, unit: str) -> str:
    return "unknown" if value is None else f"{value} {unit}"
