"""Measurement of a sensor from flats and darks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, drained
from lfcal.frames.cfa import channel_names
from lfcal.frames.photon_transfer._checks import doubts_of, notes_of
from lfcal.frames.photon_transfer._converter import Converter, ConverterScan
from lfcal.frames.photon_transfer._curve import PhotonTransferCurve, fit_curve
from lfcal.frames.photon_transfer._darks import (
    DarkLevel,
    dark_current,
    measure_darks,
    offset_scatter,
    read_noise,
)
from lfcal.frames.photon_transfer._flats import (
    FlatLevel,
    find_dead,
    measure_level,
    measure_linearity,
    measure_prnu,
    sorted_levels,
)
from lfcal.frames.photon_transfer._pairs import TransferPoints
from lfcal.frames.photon_transfer._values import MeasuredValue
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame
from lfcal.frames.photon_transfer.result import SensorMeasurement

__all__ = ["iter_measure_sensor", "measure_sensor"]

MIN_PIXELS = 1000


def iter_measure_sensor(
    flats: Sequence[CalibrationFrame], darks: Sequence[CalibrationFrame], *, cfa: str = ""
) -> Work[SensorMeasurement]:
    """Measure the gain, noise, saturation and other properties of a sensor by photon transfer.

    Parameters
    ----------
    flats
        Two or more flats for each light level. They may contain any static structure, as in white images of a lenslet
        array.
    darks
        Two or more darks for each exposure, recorded with the same settings as the flats.
    cfa
        Colour filter pattern in row-major order; empty for a monochrome sensor.

    Raises
    ------
    InputError
        If frames differ in shape, are too small, are identical, or have the same value everywhere. Also if flats are
        not brighter than darks, an exposure has only one dark, no light level has two flats, or a file is used for both
        flats and darks.
    """
    files = [{frame.source for frame in held if isinstance(frame.source, Path)} for held in (flats, darks)]
    if both := sorted(file.name for file in files[0] & files[1]):
        got = f"{both[0]} in both" + (f", and {len(both) - 1} more" if len(both) > 1 else "")
        raise InputError.expected(
            "flats and darks", "no file that is in both", got, "put flats and darks into separate folders"
        )
    clock = Clock("measure the sensor", 2 * (len(flats) + len(darks)))
    yield clock.at(0)
    scan, means = ConverterScan(), []
    shape: tuple[int, ...] = ()
    for k, frame in enumerate([*darks, *flats]):
        values = frame.read()
        shape = shape or values.shape
        if values.shape != shape:
            which = f"{'darks' if k < len(darks) else 'flats'}, {frame.label}"
            sizes = [" × ".join(map(str, size)) + " px" for size in (shape, values.shape)]
            raise InputError.expected(
                which, f"{sizes[0]} as the first dark", sizes[1], "use the same sensor settings for all"
            )
        if values.size < MIN_PIXELS:
            raise InputError.expected(
                frame.label, f"at least {MIN_PIXELS} pixels", f"{values.size}", "record larger frames"
            )
        scan.add(values, frame.label)
        means.append(float(values.mean(dtype=np.float64)))
        yield clock.at(k + 1)
    converter = scan.result()
    dimmest, brightest = min(means[: len(darks)]), max(means[len(darks) :])
    if brightest <= dimmest:
        raise InputError.expected(
            "flats",
            f"brighter frames than the darks (mean {dimmest:.4g})",
            f"{brightest:.4g} at most",
            "exchange flats and darks, or check the lamp",
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
            raise InputError.expected(
                "flats", "different frames", f"copies of one frame ({held[0].label} …)", "remove the copies"
            )
        levels.append(level)
        done += len(held)
        yield clock.at(done)
    return _measurement(converter, dark_levels, levels, cfa, (len(flats), len(darks)))


measure_sensor = drained(iter_measure_sensor)


def _by_exposure(darks: Sequence[CalibrationFrame]) -> list[list[CalibrationFrame]]:
    """Return the darks of each exposure, the shortest first; those of unknown exposure form one group."""
    found: dict[float | None, list[CalibrationFrame]] = {}
    for frame in darks:
        found.setdefault(frame.exposure_s, []).append(frame)
    return [found[key] for key in sorted(found, key=lambda seconds: seconds or 0.0)]


def _points(dark: DarkLevel, levels: Sequence[FlatLevel]) -> TransferPoints:
    parts = [] if dark.cut_off else [dark.point]
    for k, level in enumerate(levels):
        parts += [replace(pair.points, level=np.full(pair.points.x.size, k)) for pair in level.pairs]
    if not any(level.pairs for level in levels):
        raise InputError.expected("flats", "two or more of a light level", "one of each", "record pairs")
    return TransferPoints.joined(parts)


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
    rate, current = MeasuredValue(0.0, 0.0), None
    if curve.slope is not None:
        current, said = dark_current(darks, curve.slope)
        notes += [said] if said else []
        if current is not None and not said:
            rate = current.times(curve.slope)
            # darks of the shortest exposure still include its dark current
            held = rate.times(dark.exposure_s or 0.0)
            black = MeasuredValue(black.value - held.value, float(np.hypot(black.sigma, held.sigma)))
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
        shape=dark.mean.shape,
        doubts=doubts_of(converter, darks, levels, curve) + _multiplied(channels, curve),
        notes=tuple(notes),
        curve=curve,
    )


def _electrons(
    saturation: MeasuredValue | None, black: MeasuredValue, inverse: MeasuredValue | None
) -> MeasuredValue | None:
    if saturation is None or inverse is None:
        return None
    above = MeasuredValue(saturation.value - black.value, float(np.hypot(saturation.sigma, black.sigma)))
    return above.times(inverse)


def _read_noise(dark: DarkLevel, curve: PhotonTransferCurve, whole: bool, notes: list[str]) -> MeasuredValue | None:
    if dark.cut_off:
        rounding = 1 / 12 if whole else 0.0
        constant = MeasuredValue(curve.constant.value - rounding, curve.constant.sigma)
        if curve.slope is not None and constant.value > 2 * constant.sigma:
            return constant.root()
        notes.append("read noise: unknown, because the flats are too bright to show it and the darks are clipped")
        return None
    found = read_noise(dark, whole)
    if found is None:
        notes.append("read noise: below half a count and hidden by rounding; raise the camera's gain")
    return found


def _saturation(
    converter: Converter, curve: PhotonTransferCurve, black: MeasuredValue, notes: list[str]
) -> MeasuredValue | None:
    broken = curve.saturation
    if broken is not None and (converter.clip is None or broken.value < 0.95 * (converter.clip - black.value)):
        return MeasuredValue(broken.value + black.value, broken.sigma)
    if converter.clip is not None:
        return MeasuredValue(converter.clip, 0.0)
    notes.append(f"saturation and full well: not reached by the brightest sample, {converter.top:.0f}; expose longer")
    return None


def _pattern(
    levels: Sequence[FlatLevel], dark: DarkLevel, curve: PhotonTransferCurve, top: float, cfa: str, notes: list[str]
) -> tuple[MeasuredValue | None, int]:
    """Return the PRNU and the number of dead pixels, from the flats nearest to half of saturation."""
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


def _channels(
    points: TransferPoints, curve: PhotonTransferCurve, clip: float | None, whole: bool, cfa: str
) -> dict[str, MeasuredValue]:
    """Return the gain of every channel."""
    found: dict[str, MeasuredValue] = {}
    if curve.slope is None:
        return found
    for site, name in enumerate(channel_names(cfa)):
        chosen: NDArray[np.bool_] = (points.site == site) | (points.level < 0)
        own = points.where(chosen)
        if (own.level >= 0).any():
            fit = fit_curve(own, clip, whole)
            found |= {} if fit.slope is None else {name: fit.slope}
    return found


def _multiplied(channels: dict[str, MeasuredValue], curve: PhotonTransferCurve) -> tuple[str, ...]:
    """Return a doubt if gains differ between channels, which a converter does not cause."""
    if curve.slope is None or not channels:
        return ()
    middle = float(np.median([one.value for one in channels.values()]))
    if max(abs(one.value - middle) - 5 * one.sigma for one in channels.values()) <= 0.03 * middle:
        return ()
    return ("gain differs between colours, because the camera applies white balance; switch it off",)
