"""Indications that a series does not consist of raw frames of a steady scene, as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lfcal.frames.photon_transfer._converter import Converter
from lfcal.frames.photon_transfer._curve import PhotonTransferCurve
from lfcal.frames.photon_transfer._darks import ROUNDING_VARIANCE, DarkLevel
from lfcal.frames.photon_transfer._flats import FlatLevel

__all__ = ["doubts_of", "notes_of"]

MAX_CORRELATION = 0.05
"""Correlation of neighbours' noise above which pixels are not independent."""

SPARSE = 0.97
"""Fraction of used sample values below which a lookup table has stretched them."""

LAG = 1.1
FLICKER = 0.02
ROLLING = 0.002
CHI2 = 4.0


def doubts_of(
    converter: Converter, darks: Sequence[DarkLevel], flats: Sequence[FlatLevel], curve: PhotonTransferCurve
) -> tuple[str, ...]:
    """Return reasons why the values may not be those of the sensor; empty if there is no doubt."""
    doubts = [f"gain: {curve.refusal}"] if curve.refusal else []
    # darks dominated by rounding do not show their noise
    noisy = [d.likeness for d in darks if d.variance.value >= ROUNDING_VARIANCE or converter.step < 1]
    dark = np.mean(noisy, axis=0) if noisy else np.zeros(2)
    lit = _likeness(flats, curve)
    # row or column noise correlates neighbours along one axis only
    if min(dark) > MAX_CORRELATION or (
        lit is not None and min(lit) > MAX_CORRELATION and min(dark) > MAX_CORRELATION / 2
    ):
        doubts.append(
            f"the noise of neighbouring pixels is correlated ({min(dark):.2f} in darks): the frames were smoothed, "
            "scaled or debayered; record raw frames"
        )
    elif min(dark) < -MAX_CORRELATION and max(dark) < 0:
        doubts.append(
            f"the noise of neighbouring pixels is anticorrelated ({min(dark):.2f}): the frames were sharpened; "
            "record raw frames"
        )
    elif lit is not None and min(lit) > MAX_CORRELATION:
        doubts.append(
            f"neighbouring pixels are correlated in differences of flats ({min(lit):.2f}), but not in differences of "
            "darks: the light or the camera moved between the frames of a pair, or the frames were compressed"
        )
    lag = [level.lagging for level in _fitted(flats, curve) if level.lagging is not None]
    if lag and float(np.median(lag)) > LAG:
        doubts.append(
            f"frames farther apart in time differ more ({float(np.median(lag)):.2f} times the variance): the camera "
            "mixes successive frames (temporal noise filter), or the light drifts"
        )
    if converter.step == 0:
        doubts.append("samples are not whole numbers: the frames were scaled or processed; record raw frames")
    if 0 < converter.step < 1:
        doubts.append(f"samples are means of {round(1 / converter.step)} frames: gain and noise are those of the mean")
    return tuple(doubts)


def notes_of(
    converter: Converter, darks: Sequence[DarkLevel], flats: Sequence[FlatLevel], curve: PhotonTransferCurve
) -> tuple[str, ...]:
    """Return remarks on the series that do not invalidate the values."""
    notes = []
    if converter.shift:
        notes.append(f"samples are left-aligned by {converter.shift} bits; all counts refer to samples shifted down")
    if converter.step > 1 or converter.used < SPARSE:
        notes.append(
            f"{100 * min(converter.used, 1 / max(converter.step, 1)):.0f} % of the possible sample values occur: "
            "a lookup table or a factor stretched them"
        )
    pairs = [pair for level in flats for pair in level.pairs]
    change = max((abs(pair.change) for pair in pairs), default=0.0)
    if change > FLICKER:
        notes.append(f"the light changes by up to {100 * change:.1f} % within a pair; this is taken into account")
    rolling = max((pair.rolling for pair in pairs), default=0.0)
    if rolling > ROLLING:
        notes.append(
            f"the light varies from row to row ({100 * rolling:.1f} % rms), because the lamp flickers; this is taken "
            "into account"
        )
    if darks[0].cut_off:
        notes.append(
            "darks are clipped at zero: black level and offsets are unknown, and read noise is derived from the curve; "
            "raise the camera's black level"
        )
    if not curve.refusal and abs(curve.departure) > 0:
        notes.append(
            f"the variance departs from a straight line by {100 * curve.departure:+.1f} % at {curve.limit:.0f} counts; "
            "the gain is the initial slope"
        )
    if curve.chi2 > CHI2:
        notes.append(
            f"points scatter {curve.chi2**0.5:.1f} times as much as expected by chance; errors are enlarged accordingly"
        )
    return tuple(notes)


def _fitted(flats: Sequence[FlatLevel], curve: PhotonTransferCurve) -> list[FlatLevel]:
    """Return the levels with pairs within the fitted range, or else the dimmest."""
    paired = [level for level in flats if level.pairs]
    return [level for level in paired if float(level.bright.mean()) < curve.limit] or paired[:1]


def _likeness(flats: Sequence[FlatLevel], curve: PhotonTransferCurve) -> tuple[float, float] | None:
    """Return the correlation of neighbours (along columns, along rows) in differences of the brightest fitted flats."""
    levels = _fitted(flats, curve)
    if not levels:
        return None
    rows, columns = np.mean([pair.likeness for pair in levels[-1].pairs], axis=0).tolist()
    return rows, columns
