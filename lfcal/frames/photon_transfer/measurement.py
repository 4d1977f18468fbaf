"""The sensor's figures from flats and darks, all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, Sensor
from lfcal.errors import InputError
from lfcal.frames.cfa import channel_names
from lfcal.frames.photon_transfer.checks import doubts_of, notes_of
from lfcal.frames.photon_transfer.converter import Converter, ConverterScan
from lfcal.frames.photon_transfer.curve import Curve, fit_curve
from lfcal.frames.photon_transfer.darks import (
    DarkLevel,
    dark_current,
    measure_darks,
    offset_scatter,
    read_noise,
)
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame
from lfcal.frames.photon_transfer.levels import FlatLevel, measure_level, sorted_levels
from lfcal.frames.photon_transfer.linearity import measure_linearity
from lfcal.frames.photon_transfer.pairs import Points
from lfcal.frames.photon_transfer.pattern import find_dead, measure_prnu
from lfcal.frames.photon_transfer.values import Measured
from lfcal.progress import Clock, Work, drain

__all__ = ["SensorMeasurement", "iter_measure_sensor", "measure_sensor"]

FEWEST_PIXELS = 1000


@dataclass(frozen=True)
class SensorMeasurement:
    """What flats and darks tell of a sensor; None: they do not tell it, and ``notes`` say why.

    Attributes
    ----------
    gain
        Sample values per electron.
    black_level
        Sample value of no light; None where darks are cut off at zero.
    dark_level
        Mean of the darks of the shortest exposure (sample values), from which signals are counted.
    read_noise_counts, read_noise_e
        Rms, without that of rounding.
    saturation
        Sample value from which samples carry no measurement.
    full_well_e
        Electrons there.
    linearity
        Largest relative departure of the signal from a line over exposure, between 5 and 95 % of saturation.
    prnu
        Relative rms of the pixels' responses.
    dsnu_counts, dsnu_e
        Rms of the pixels' offsets.
    dark_current_e_s
        Electrons per pixel and second.
    bits
        Bits that the sample values need.
    shift
        Bits by which left-aligned samples were moved down; all counts are after that.
    hot, dead
        Pixels too bright in the dark, and blind ones; they are left out of everything else.
    channels
        Gain of each channel of the colour filter pattern.
    frames
        Flats and darks read.
    doubts
        Why the figures are not those of the sensor; empty where nothing speaks against them.
    notes
        What else is worth knowing.
    curve
        The photon-transfer curve.
    """

    gain: Measured | None
    black_level: Measured | None
    dark_level: Measured
    read_noise_counts: Measured | None
    read_noise_e: Measured | None
    saturation: Measured | None
    full_well_e: Measured | None
    linearity: Measured | None
    prnu: Measured | None
    dsnu_counts: Measured | None
    dsnu_e: Measured | None
    dark_current_e_s: Measured | None
    bits: int
    shift: int
    hot: int
    dead: int
    channels: dict[str, Measured]
    frames: tuple[int, int]
    doubts: tuple[str, ...]
    notes: tuple[str, ...]
    curve: Curve = field(repr=False, compare=False)

    @property
    def electrons_per_count(self) -> Measured | None:
        """One over the gain."""
        return None if self.gain is None else self.gain.inverse()

    def sensor(self, known: Sensor) -> tuple[Sensor, tuple[str, ...]]:
        """Return ``known`` with what was measured, and the names of those entries.

        Raises
        ------
        InputError
            If the figures are doubtful, or the samples need more bits than ``known`` has and do not show how many.
        """
        if self.doubts or self.gain is None:
            why = self.doubts[0] if self.doubts else "the gain was not measured"
            raise InputError.expected("measured sensor", "figures to rely on", why, "record raw flats and darks again")
        clip = self.saturation.value if self.saturation is not None else None
        # a converter ends at a power of two; a level below that is the pixels' own
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
            found: Measured | None = getattr(self, name)
            if found is not None:
                values[name] = max(0.0, found.value)
        changed = tuple(name for name in values if name != "bit_depth" or full)
        # levels of the earlier description may not fit the new bit depth
        return replace(known, **{"saturation": None, **values}), changed  # type: ignore[arg-type]

    def camera(self, known: Camera) -> Camera:
        """Return ``known`` with its sensor as measured, marked so."""
        sensor, changed = self.sensor(known.sensor)
        return replace(known, sensor=sensor, marks=known.marks.marked([f"sensor.{n}" for n in changed], "measured"))


def measure_sensor(
    flats: Sequence[CalibrationFrame], darks: Sequence[CalibrationFrame], *, cfa: str = ""
) -> SensorMeasurement:
    """Measure a sensor at once; see `iter_measure_sensor`."""
    return drain(iter_measure_sensor(flats, darks, cfa=cfa))


def iter_measure_sensor(
    flats: Sequence[CalibrationFrame], darks: Sequence[CalibrationFrame], *, cfa: str = ""
) -> Work[SensorMeasurement]:
    """Measure a sensor by photon transfer.

    Parameters
    ----------
    flats
        Two or more of each level of light, of any structure that stays (a white image of a lenslet array is well).
    darks
        Two or more of each exposure, recorded as the flats are.
    cfa
        Colour filter pattern by rows, empty for none.

    Raises
    ------
    InputError
        If frames are of unlike shape, alike to the last bit, single, without light, or saturated everywhere.
    """
    files = [{frame.source for frame in held if isinstance(frame.source, Path)} for held in (flats, darks)]
    if files[0] & files[1]:
        raise InputError.expected(
            "flats and darks", "different files", "the same ones", "give each a folder of its own"
        )
    clock = Clock("measure the sensor", 2 * (len(flats) + len(darks)))
    yield clock.at(0)
    scan, means = ConverterScan(), []
    shape: tuple[int, ...] = ()
    for k, frame in enumerate([*darks, *flats]):
        values = frame.read()
        shape = shape or values.shape
        if values.shape != shape:
            raise InputError.expected(frame.label, f"{shape} px as the others", values.shape, "take one sensor setting")
        if values.size < FEWEST_PIXELS:
            raise InputError.expected(
                frame.label, f"{FEWEST_PIXELS} pixels or more", f"{values.shape}", "take larger frames"
            )
        scan.add(values, frame.label)
        means.append(float(values.mean(dtype=np.float64)))
        yield clock.at(k + 1)
    converter = scan.result()
    dimmest, brightest = min(means[: len(darks)]), max(means[len(darks) :])
    if brightest <= dimmest:
        raise InputError.expected(
            "flats", f"brighter frames than the darks (mean {dimmest:.4g})", f"{brightest:.4g} at most", "exchange them"
        )
    if converter.shift:
        flats, darks = ([f.moved(converter.shift) for f in held] for held in (flats, darks))
    light = [mean / (1 << converter.shift) for mean in means[len(darks) :]]
    done = len(flats) + len(darks)
    dark_levels = []
    for held in _by_exposure(darks):
        dark_levels.append(measure_darks(held, held[0].exposure_s))
        done += len(held)
        yield clock.at(done)
    reference = dark_levels[0]
    levels = []
    for held in sorted_levels(flats, light, reference.black.value):
        level = measure_level(held, reference.mean, reference.good, cfa)
        if any(pair.equal for pair in level.pairs):
            raise InputError.expected("flats", "frames that differ", f"copies among {held[0].label} …", "remove copies")
        levels.append(level)
        done += len(held)
        yield clock.at(done)
    return _measurement(converter, dark_levels, levels, cfa, (len(flats), len(darks)))


def _by_exposure(darks: Sequence[CalibrationFrame]) -> list[list[CalibrationFrame]]:
    """Return the darks of each exposure, the shortest first; those of unknown exposure are one."""
    held: dict[float | None, list[CalibrationFrame]] = {}
    for frame in darks:
        held.setdefault(frame.exposure_s, []).append(frame)
    return [held[key] for key in sorted(held, key=lambda seconds: seconds or 0.0)]


def _points(dark: DarkLevel, levels: Sequence[FlatLevel]) -> Points:
    parts = [] if dark.cut_off else [dark.point]
    for k, level in enumerate(levels):
        parts += [replace(pair.points, level=np.full(pair.points.x.size, k)) for pair in level.pairs]
    if not any(level.pairs for level in levels):
        raise InputError.expected("flats", "two or more of a level", "one of each", "record them in pairs")
    return Points.joined(parts)


def _measurement(
    converter: Converter, darks: list[DarkLevel], levels: list[FlatLevel], cfa: str, frames: tuple[int, int]
) -> SensorMeasurement:
    dark, whole = darks[0], converter.step == 1 or converter.step > 1
    black = dark.black
    clip = None if converter.clip is None else converter.clip - black.value
    points = _points(dark, levels)
    curve = fit_curve(points, clip, whole)
    notes = list(notes_of(converter, darks, levels, curve))
    inverse = None if curve.slope is None else curve.slope.inverse()
    read = _read_noise(dark, curve, whole, notes)
    saturation = _saturation(converter, curve, black, notes)
    end = (1 << int(converter.top).bit_length()) - 1
    top = (end if saturation is None else saturation.value) - dark.black.value
    rate, current = Measured(0.0, 0.0), None
    if curve.slope is not None:
        current, said = dark_current(darks, curve.slope)
        notes += [said] if said else []
        if current is not None and not said:
            rate = current.times(curve.slope)
            # darks of the shortest exposure still hold its dark current
            held = rate.times(dark.exposure_s or 0.0)
            black = Measured(black.value - held.value, float(np.hypot(black.sigma, held.sigma)))
    linearity, said = measure_linearity(levels, dark.good, top, rate.value, dark.exposure_s or 0.0)
    notes += [said] if said else []
    prnu, dead = _pattern(levels, dark, curve, top, cfa, notes)
    offsets = offset_scatter(dark, whole)
    channels = _channels(points, curve, clip, whole, cfa)
    return SensorMeasurement(
        gain=curve.slope,
        black_level=None if dark.cut_off else black,
        dark_level=dark.black,
        read_noise_counts=read,
        read_noise_e=None if inverse is None or read is None else read.times(inverse),
        saturation=saturation,
        full_well_e=_electrons(saturation, black, inverse),
        linearity=linearity,
        prnu=prnu,
        dsnu_counts=offsets,
        dsnu_e=None if inverse is None or offsets is None else offsets.times(inverse),
        dark_current_e_s=current,
        bits=int(converter.top).bit_length(),
        shift=converter.shift,
        hot=int(np.count_nonzero(~dark.good)),
        dead=dead,
        channels=channels,
        frames=frames,
        doubts=doubts_of(converter, darks, levels, curve) + _multiplied(channels, curve),
        notes=tuple(notes),
        curve=curve,
    )


def _electrons(saturation: Measured | None, black: Measured, inverse: Measured | None) -> Measured | None:
    if saturation is None or inverse is None:
        return None
    above = Measured(saturation.value - black.value, float(np.hypot(saturation.sigma, black.sigma)))
    return above.times(inverse)


def _read_noise(dark: DarkLevel, curve: Curve, whole: bool, notes: list[str]) -> Measured | None:
    if dark.cut_off:
        rounding = 1 / 12 if whole else 0.0
        constant = Measured(curve.constant.value - rounding, curve.constant.sigma)
        if curve.slope is not None and constant.value > 2 * constant.sigma:
            return constant.root()
        notes.append("read noise: unknown, for the flats are too bright to show it and the darks are cut off")
        return None
    found = read_noise(dark, whole)
    if found is None:
        notes.append("read noise: below half a count and lost in rounding; raise the camera's gain")
    return found


def _saturation(converter: Converter, curve: Curve, black: Measured, notes: list[str]) -> Measured | None:
    broken = curve.saturation
    if broken is not None and (converter.clip is None or broken.value < 0.95 * (converter.clip - black.value)):
        return Measured(broken.value + black.value, broken.sigma)
    if converter.clip is not None:
        return Measured(converter.clip, 0.0)
    notes.append(f"saturation and full well: unknown, for the brightest sample is {converter.top:.0f}; expose longer")
    return None


def _pattern(
    levels: Sequence[FlatLevel], dark: DarkLevel, curve: Curve, top: float, cfa: str, notes: list[str]
) -> tuple[Measured | None, int]:
    """Return pixel response and blind pixels, from the flats nearest to half of saturation."""
    means = np.array([float(level.bright[dark.good].mean(dtype=np.float64)) for level in levels])
    nearest = int(np.argmin(np.abs(means - 0.5 * top)))
    level = levels[nearest]
    if curve.slope is None:
        return None, 0
    noise = float(np.sqrt(curve.variance(means[nearest]) / level.count))
    dead = find_dead(level.bright, dark.good, noise, cfa)
    prnu, said = measure_prnu(level, curve, dark.variance.value / dark.count, dark.good & ~dead, cfa)
    notes += [said] if said else []
    return prnu, int(np.count_nonzero(dead))


def _channels(points: Points, curve: Curve, clip: float | None, whole: bool, cfa: str) -> dict[str, Measured]:
    """Return the gain of every channel."""
    found: dict[str, Measured] = {}
    if curve.slope is None:
        return found
    for site, name in enumerate(channel_names(cfa)):
        chosen: NDArray[np.bool_] = (points.site == site) | (points.level < 0)
        own = points.where(chosen)
        if (own.level >= 0).any():
            fit = fit_curve(own, clip, whole)
            found |= {} if fit.slope is None else {name: fit.slope}
    return found


def _multiplied(channels: dict[str, Measured], curve: Curve) -> tuple[str, ...]:
    """Return the doubt that gains differ between channels, which a converter does not make."""
    if curve.slope is None or not channels:
        return ()
    middle = float(np.median([one.value for one in channels.values()]))
    if max(abs(one.value - middle) - 5 * one.sigma for one in channels.values()) <= 0.03 * middle:
        return ()
    return ("gain differs between colours: the camera multiplies them (white balance); switch that off",)
