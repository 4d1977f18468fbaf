"""A measurement in words: one line a figure, and what sets it apart from the sensor that is described."""

from __future__ import annotations

from lfcal.base import InputError, format_number
from lfcal.camera import Sensor
from lfcal.frames.photon_transfer.result import SensorMeasurement
from lfcal.frames.photon_transfer.values import MeasuredValue

__all__ = ["figures_of", "unlike"]

SMALLEST, LARGEST = 0.5, 2.0
"""Ratio of electrons per count, measured over stated, outside which one of them is doubted."""


def figures_of(found: SensorMeasurement, known: Sensor | None = None) -> list[tuple[str, str]]:
    """Return name and value with its error and unit of every figure; "unknown" where it could not be told.

    Parameters
    ----------
    found
        The measurement.
    known
        The sensor as it is described; with it the full well that its description takes over is told, too.
    """
    channels = [(f"  {name}", _text(gain, "counts per e⁻")) for name, gain in found.channels.items()]
    return [
        ("gain", _text(found.gain, "counts per e⁻")),
        ("", _text(found.electrons_per_count, "e⁻ per count")),
        *channels,
        ("black level", _text(found.black_level, "counts")),
        ("read noise", _text(found.read_noise_e, "e⁻ rms")),
        ("", _text(found.read_noise_counts, "counts rms")),
        ("saturated from", _reached(found.saturation, found.brightest, "counts", found)),
        ("full well", _reached(found.full_well_e, _brightest_e(found), "e⁻", found)),
        *_taken(found, known),
        ("departure from linearity", _text(_percent(found.linearity), "% at most")),
        ("pixel response (PRNU)", _text(_percent(found.prnu), "% rms")),
        ("offsets (DSNU)", _text(found.dsnu_e, "e⁻ rms")),
        ("dark current", _text(found.dark_current_e_s, "e⁻/s")),
        ("bits in use", f"{found.bits}" + (f", left-aligned by {found.shift}" if found.shift else "")),
        ("hot and dead pixels", f"{found.hot}, {found.dead}"),
    ]


def unlike(found: SensorMeasurement, known: Sensor) -> list[str]:
    """Return what the frames have that the sensor ``known`` has not: another size, another gain."""
    words = []
    if found.shape != known.shape:
        sizes = [" × ".join(map(str, size)) for size in (found.shape, known.shape)]
        words.append(
            f"frames of {sizes[0]} px, and the camera's sensor has {sizes[1]}: a part of it, or another camera"
        )
    if found.electrons_per_count is not None:
        stated = known.electrons_per_count * (1 << found.shift)
        ratio = found.electrons_per_count.value / stated
        if not SMALLEST <= ratio <= LARGEST:
            words.append(
                f"{ratio:.3g} times as many electrons per count as the camera description has ({stated:.4g}): "
                "another gain setting, or frames that the camera averaged or denoised"
            )
    return words


def _taken(found: SensorMeasurement, known: Sensor | None) -> list[tuple[str, str]]:
    """Return the full well that the description of ``known`` takes over, which belongs to its highest sample value."""
    if known is None or found.gain is None:
        return []
    try:
        sensor, _ = found.sensor(known)
    except InputError:  # nothing is taken over
        return []
    full = MeasuredValue(sensor.full_well_e, sensor.full_well_e * found.gain.sigma / found.gain.value)
    return [("  for the camera", f"{full} e⁻ at its highest count, {sensor.max_value}")]


def _brightest_e(found: SensorMeasurement) -> float:
    return 0.0 if found.gain is None else (found.brightest - found.dark_level.value) / found.gain.value


def _reached(value: MeasuredValue | None, brightest: float, unit: str, found: SensorMeasurement) -> str:
    """Return a limit in words; where no flat reached it, what it is above."""
    if value is not None or found.gain is None:
        return _text(value, unit)
    return f"above {format_number(brightest)} {unit} (not reached)"


def _percent(value: MeasuredValue | None) -> MeasuredValue | None:
    return None if value is None else value.times(100.0)


def _text(value: MeasuredValue | None, unit: str) -> str:
    return "unknown" if value is None else f"{value} {unit}"
