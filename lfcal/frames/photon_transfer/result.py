"""Measured properties of a sensor: as text, as a plot, and in a camera."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lfcal.base import LINES, InputError, figure, format_number, save_figure
from lfcal.camera import Camera, Sensor
from lfcal.frames.photon_transfer._curve import PhotonTransferCurve
from lfcal.frames.photon_transfer._values import MeasuredValue

__all__ = ["SensorMeasurement", "figures_of", "save_curve", "sensor_differences"]


VALUES = (
    *("gain", "electrons_per_count", "black_level", "read_noise_counts", "read_noise_e", "saturation", "full_well_e"),
    *("linearity", "prnu", "dsnu_counts", "dsnu_e", "dark_current_e_s"),
)
"""Measured values, in the order in which they are listed."""


@dataclass(frozen=True)
class SensorMeasurement:
    """Sensor properties measured from flats and darks.

    A value that could not be determined is None; ``notes`` gives the reason.

    Attributes
    ----------
    gain
        Gain (sample values per electron).
    black_level
        Sample value without light; None if darks are clipped at zero.
    dark_level
        Mean of the darks with the shortest exposure (sample values), to which signals are relative.
    read_noise_counts, read_noise_e
        Rms read noise without quantisation noise, in sample values and in electrons.
    saturation
        Sample value at which pixels are saturated.
    full_well_e
        Electrons at saturation.
    linearity
        Largest relative deviation of the signal from a straight line over exposure, between 5 and 95 % of saturation.
    prnu
        Photo-response non-uniformity: rms variation of the pixels' responses, relative to their mean.
    dsnu_counts, dsnu_e
        Dark-signal non-uniformity: rms variation of the pixels' offsets, in sample values and in electrons.
    dark_current_e_s
        Dark current (electrons per pixel and second).
    bits
        Number of bits that the sample values need.
    shift
        Number of bits by which left-aligned samples were shifted to the right; all sample values refer to shifted
        samples.
    hot, dead
        Numbers of hot pixels, which are too bright in the darks, and of dead pixels, which are too dark in the flats.
    channels
        Gain of each channel of the colour filter pattern, by name.
    frames
        Numbers of flats and of darks read.
    shape
        Rows and columns of a frame.
    doubts
        Reasons why the values may not be those of the sensor; empty if there is no doubt.
    notes
        Remarks, including the reasons for values that were not determined.
    curve
        The photon-transfer curve.
    """

    gain: MeasuredValue | None
    black_level: MeasuredValue | None
    dark_level: MeasuredValue
    read_noise_counts: MeasuredValue | None
    read_noise_e: MeasuredValue | None
    saturation: MeasuredValue | None
    full_well_e: MeasuredValue | None
    linearity: MeasuredValue | None
    prnu: MeasuredValue | None
    dsnu_counts: MeasuredValue | None
    dsnu_e: MeasuredValue | None
    dark_current_e_s: MeasuredValue | None
    bits: int
    shift: int
    hot: int
    dead: int
    channels: dict[str, MeasuredValue]
    frames: tuple[int, int]
    shape: tuple[int, int]
    doubts: tuple[str, ...]
    notes: tuple[str, ...]
    curve: PhotonTransferCurve = field(repr=False, compare=False)

    @property
    def electrons_per_count(self) -> MeasuredValue | None:
        """Electrons per sample value, the reciprocal of the gain; None if it was not determined."""
        return None if self.gain is None else self.gain.inverse()

    def to_dict(self) -> dict[str, Any]:
        """Return the measured values, their standard errors and the photon-transfer curve as a dictionary."""
        found: dict[str, Any] = {}
        for name in VALUES:
            one: MeasuredValue | None = getattr(self, name)
            found[name] = None if one is None else one._asdict()
        points = self.curve.points
        return {
            **found,
            **{name: getattr(self, name) for name in ("bits", "shift", "hot", "dead", "doubts", "notes")},
            "channels": {name: gain._asdict() for name, gain in self.channels.items()},
            "frames": {"flats": self.frames[0], "darks": self.frames[1]},
            "curve": {"signal": points.x, "variance": points.y, "pixels": points.n, "fitted": self.curve.used},
        }

    @property
    def brightest(self) -> float:
        """Highest sample value on the photon-transfer curve, whose points are means of pixels of similar value."""
        return self.dark_level.value + float(self.curve.points.x.max())

    def sensor(self, known: Sensor) -> tuple[Sensor, tuple[str, ...]]:
        """Return the sensor ``known`` with the measured values, and the names of the measured fields.

        The full well of a sensor description refers to the highest sample value, even if pixels saturate at a lower
        one.

        Raises
        ------
        InputError
            If the values are doubtful, or the gain was not determined.
        """
        if self.doubts or self.gain is None:
            why = self.doubts[0] if self.doubts else "the gain was not measured"
            raise InputError.expected(
                "measured sensor", "reliable values", f"doubtful ones ({why})", "record raw flats and darks again"
            )
        clip = self.saturation.value if self.saturation is not None else None
        # a converter ends at a power of two; a lower level is due to the pixels
        full = clip is not None and int(clip + 1) & int(clip) == 0
        bits = self.bits if full or self.bits > known.bit_depth else known.bit_depth
        values: dict[str, float | int] = {"bit_depth": bits}
        if self.black_level is not None:
            values["black_level"] = max(0.0, self.black_level.value)
        top, black = (1 << bits) - 1, values.get("black_level", known.black_level)
        values["full_well_e"] = (top - black) / self.gain.value
        if clip is not None:
            values["saturation"] = clip
        for name in ("read_noise_e", "dark_current_e_s", "prnu", "dsnu_e", "linearity"):
            found: MeasuredValue | None = getattr(self, name)
            if found is not None:
                values[name] = max(0.0, found.value)
        changed = tuple(name for name in values if name != "bit_depth" or full)
        # a stated level is kept unless it has another bit depth, or the frames exceed it
        stays = known.saturation if bits == known.bit_depth and (known.saturation or 0) > self.brightest else None
        return replace(known, **{"saturation": stays, **values}), changed  # type: ignore[arg-type]

    def camera(self, known: Camera) -> Camera:
        """Return the camera ``known`` with the measured sensor values, marked as measured.

        Raises
        ------
        InputError
            As in `SensorMeasurement.sensor`.
        """
        sensor, changed = self.sensor(known.sensor)
        return replace(known, sensor=sensor, marks=known.marks.marked([f"sensor.{n}" for n in changed], "measured"))


SMALLEST, LARGEST = 0.5, 2.0
"""Ratio of measured to stated electrons per count outside which one of them is doubted."""


def figures_of(found: SensorMeasurement, known: Sensor | None = None) -> list[tuple[str, str]]:
    """Return (name, text) for every property; an empty name denotes the previous property in another unit.

    The text is the value with its standard error and unit, "unknown", or a lower bound if no flat was bright enough.

    Parameters
    ----------
    found
        The measured properties.
    known
        The sensor before the measurement. If it is given, the full well to state in its description is included.
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


def sensor_differences(found: SensorMeasurement, known: Sensor) -> list[str]:
    """Return descriptions of how the size and the gain of the frames differ from those of the sensor ``known``.

    Small differences of the gain are omitted.
    """
    words = []
    if found.shape != known.shape:
        sizes = [" × ".join(map(str, size)) for size in (found.shape, known.shape)]
        words.append(
            f"the frames have {sizes[0]} px, the camera's sensor {sizes[1]}: they show a part of it, or are from "
            "another camera"
        )
    if found.electrons_per_count is not None:
        stated = known.electrons_per_count * (1 << found.shift)
        ratio = found.electrons_per_count.value / stated
        if not SMALLEST <= ratio <= LARGEST:
            words.append(
                f"{ratio:.3g} times as many electrons per count as in the camera description ({stated:.4g}): "
                "the gain setting differs, or the camera averaged or denoised the frames"
            )
    return words


def _taken(found: SensorMeasurement, known: Sensor | None) -> list[tuple[str, str]]:
    """Return the full well for the description of ``known``, which refers to its highest sample value."""
    if known is None or found.gain is None:
        return []
    try:
        sensor, _ = found.sensor(known)
    except InputError:  # the description would not change
        return []
    full = MeasuredValue(sensor.full_well_e, sensor.full_well_e * found.gain.sigma / found.gain.value)
    return [("  for the camera", f"{full} e⁻ at its highest count, {sensor.max_value}")]


def _brightest_e(found: SensorMeasurement) -> float:
    return 0.0 if found.gain is None else (found.brightest - found.dark_level.value) / found.gain.value


def _reached(value: MeasuredValue | None, brightest: float, unit: str, found: SensorMeasurement) -> str:
    """Return a limit in words; if no flat reached it, a lower bound."""
    if value is not None or found.gain is None:
        return _text(value, unit)
    return f"above {format_number(brightest)} {unit} (not reached)"


def _percent(value: MeasuredValue | None) -> MeasuredValue | None:
    return None if value is None else value.times(100.0)


def _text(value: MeasuredValue | None, unit: str) -> str:
    return "unknown" if value is None else f"{value} {unit}"


def save_curve(found: SensorMeasurement, path: str | os.PathLike[str]) -> None:
    """Save a plot of the photon-transfer curve to ``path``: rms noise versus signal, with logarithmic axes."""
    curve = found.curve
    with figure(6.4, 4.4) as fig:
        axes = fig.add_subplot()
        lit = curve.points.x > 0
        for chosen, colour, label in (
            (lit & curve.used, LINES[0], "measured, fitted"),
            (lit & ~curve.used, LINES[5], "measured, not fitted"),
        ):
            x, y = curve.points.x[chosen], np.sqrt(np.maximum(curve.points.y[chosen], 0))
            axes.plot(x, y, "o", ms=3, color=colour, label=label)
        if curve.slope is not None:
            first = max(float(curve.points.x[lit].min()) / 3, 1e-2)
            x = np.geomspace(first, curve.limit, 200)
            axes.plot(
                x, np.sqrt(curve.variance(x)), color=LINES[1], label=f"fit: {found.electrons_per_count} e⁻ per count"
            )
            axes.plot(x, np.sqrt(curve.slope.value * x), ":", color=LINES[6], label="photon noise alone")
        if found.read_noise_counts is not None:
            axes.axhline(found.read_noise_counts.value, ls="--", color=LINES[2], label="read noise")
        if found.saturation is not None:
            axes.axvline(found.saturation.value - found.dark_level.value, color=LINES[3], label="saturation")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("signal above black (counts)")
        axes.set_ylabel("noise, rms (counts)")
        axes.set_title("Photon transfer")
        axes.legend()
        save_figure(fig, path)
