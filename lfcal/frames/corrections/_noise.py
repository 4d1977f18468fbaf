"""The variance of a corrected sample."""

from __future__ import annotations

import numpy as np

from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.regions import Region
from lfcal.frames.source import Noise, Number

__all__ = ["corrected_noise"]

LEAST = 0.25
"""Share of the read noise's variance that is left at least: a dark's own noise must not make a variance negative."""


def corrected_noise(
    raw: Noise, chain: CorrectionChain, region: Region, exposure_s: float | None, background: float = 0.0
) -> Noise:
    """Return the noise of samples as ``chain`` corrects them.

    A raw sample of value r has the variance ``c + s max(r - black, 0)``. With the dark d, of variance e, the white's
    factor w, the exposure's factor f and the background b the corrected sample is ``v = (r - d) w f - b``: of variance
    ``(w f)^2 (c + s (d - black) + e) + w f s (v + b)``. Only what is known counts: e where it is known of how many
    frames the dark is the mean; d - black from the median of the dark, where the black level is not known.

    Parameters
    ----------
    raw
        Of the raw samples.
    chain, region, exposure_s
        The corrections, the sensor region, and the exposure of the frame (s).
    background
        What was taken off at the end (corrected sample values).
    """
    constant: Number = raw.constant
    dark = chain.dark_at(exposure_s)
    black = raw.black
    if dark is not None:
        frame = dark.part(region)
        if frame is not None:
            held = frame.astype(np.float64) + dark.level
            # light of the dark itself: dark current and hot pixels bring their own photon noise
            shown = held - (float(np.median(held)) if black is None else black)
            constant = np.maximum(constant + raw.slope * shown, LEAST * np.asarray(raw.constant))
            constant = constant * (1 + 1 / dark.count) if dark.count else constant
        black = 0.0
    gain = chain.gain(region)
    factor: Number = chain.factor(exposure_s) if gain is None else gain * chain.factor(exposure_s)
    slope = raw.slope * factor
    kept = None if black is None else black * chain.factor(exposure_s) - background
    if dark is not None or not kept:
        return Noise(constant * factor**2 + slope * max(background, 0.0), slope)
    return Noise(constant * factor**2, slope, kept)
