"""A frame source that applies a correction chain; all frames are corrected here."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, LfcalError, Region, check_region, format_pixels, grow_region, moved, part_of, whole
from lfcal.frames.cfa import pattern_side
from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.corrections.defects import repair_nan
from lfcal.frames.corrections.steps import Exposure, White
from lfcal.frames.source import (
    DarkNoise,
    FrameInfo,
    FrameMetadata,
    Frames,
    FrameSource,
    Noise,
    Number,
    Samples,
    observed,
)
from lfcal.frames.view import SourceView

__all__ = ["CorrectedSource", "corrected", "corrected_noise"]


class CorrectedSource(SourceView):
    """View of ``source`` with corrected float32 frames; reading a region processes only the region and its margin.

    Calibration frames are in sensor coordinates, so a frame that is a cutout is corrected at its position on the
    sensor. If the background is measured on each frame, the complete frame is read.
    """

    def __init__(self, source: FrameSource, chain: CorrectionChain) -> None:
        super().__init__(source)
        self.chain = chain
        # first and last frame represent all: a session records either cutouts or whole frames
        cut = any(source.info(k).origin != (0, 0) for k in {0, len(source) - 1} if k >= 0 and len(source))
        # a fixed part of the sensor, with calibration frames of the same part
        part = self.known.origin
        self._first = (0, 0)
        if part is not None and chain.shape in (None, source.shape):
            cut, self._first = False, part
        if cut and chain.measures_frames:
            raise InputError.expected(
                "background", "a constant for cutouts", "a measurement on whole frames", "use a constant"
            )
        if not cut and chain.shape is not None and chain.shape != source.shape:
            if chain.shape == source.shape[::-1]:
                raise InputError.expected(
                    "frames and their calibration frames",
                    "the same orientation of all",
                    f"frames of {format_pixels(source.shape)}, and dark or white frames of "
                    f"{format_pixels(chain.shape)}, rotated by 90°",
                    "give dark and white frames as the camera delivers them; the orientation is applied to all",
                )
            raise InputError.expected(
                "frames",
                f"{format_pixels(chain.shape)}, as in the calibration frames",
                format_pixels(source.shape),
                "record frames, dark and white with the same sensor settings",
            )

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type, float32."""
        return np.dtype(np.float32)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` of the raw frames with a description of the corrections added."""
        chain, dark = self.chain, self.chain.only_dark()
        noise = known.dark_noise
        if dark is not None and dark.count:
            # samples without a factor have the variance of raw ones
            plain = not any(isinstance(step, White | Exposure) for step in chain.steps)
            noise = DarkNoise(dark.count, dark.variance if plain else None)
        return replace(known, corrections=chain.describe(), keeps_level=chain.keeps_level(), dark_noise=noise)

    def repeats(self) -> FrameSource | None:
        """Return the repeated frames of the source with the same corrections; None if it has none."""
        found = self.source.repeats() if isinstance(self.source, Frames) else None
        return None if found is None else CorrectedSource(found, self.chain)

    def read(self, index: int, region: Region | None = None) -> NDArray[np.float32]:
        """Return the corrected frame ``index``, or the part of it in ``region``."""
        values: NDArray[np.float32] = self.samples(index, region).values
        return values

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the corrected samples of frame ``index``, or of the part of it in ``region``.

        Saturation is determined from the raw values.

        Raises
        ------
        LfcalError
            If the frame cannot be read or corrected; the message states its name.
        """
        inside = check_region(region or whole(self.shape), self.shape)
        info = self.source.info(index)
        masked = self.chain.masked(self._placed(inside, info)) is not None
        margin = self.chain.margin + (pattern_side(self.known.cfa) if masked else 0)
        grown = whole(self.shape) if self.chain.measures_frames else grow_region(inside, margin, self.shape)
        raw = self.source.samples(index, grown)
        # saturation is a property of raw samples: after dark and white corrections, its level is no longer one number
        if self.chain.saturation is not None:
            raw = observed(raw.values, self.chain.saturation, raw.noise)
        try:
            values, level = self._correct(raw.values, grown, grown if masked else inside, info)
        except LfcalError as error:
            raise type(error)(f"{info.label}: {error}") from error
        unknown = None
        if masked:
            values, unknown = self._filled(values, grown, inside, info)
        valid, count = self._usable(raw, grown, inside, info, unknown)
        return Samples(values, valid, self._noise(raw.noise, inside, info, level), count)

    def _correct(
        self, part: NDArray[Any], grown: Region, inside: Region, info: FrameInfo
    ) -> tuple[NDArray[np.float32], float]:
        """Return the corrected samples, and the background that was subtracted at their centre."""
        plane = None
        if self.chain.measures_frames:
            plane = self.chain.measure(lambda region: part[region], self.shape, exposure_s=info.exposure_s)
        values = self.chain.apply_region(
            part,
            self._placed(grown, info),
            inside=self._placed(inside, info),
            exposure_s=info.exposure_s,
            background=plane,
        )
        if plane is None:
            plane = self.chain.measure(lambda _: part, self.shape, exposure_s=info.exposure_s)
        middle = tuple((side.start + side.stop - 1) / 2 for side in self._placed(inside, info))
        return values, self.chain.level(plane, info.exposure_s, (middle[0], middle[1]))

    def _filled(
        self, values: NDArray[np.float32], grown: Region, inside: Region, info: FrameInfo
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the samples in ``inside`` without NaN, and a map of those that are unknown.

        Unknown samples become the mean of their nearest neighbours within one period of the colour pattern, else 0.
        """
        unknown = np.isnan(values)
        lost = self.chain.masked(self._placed(grown, info))
        if lost is not None:
            unknown |= lost
        values = np.array(values)
        repair_nan(values, (grown[0].start, grown[1].start), np.zeros(3), self.known.cfa)
        values[np.isnan(values)] = 0.0
        cut = part_of(inside, grown)
        return np.ascontiguousarray(values[cut]), unknown[cut]

    def _usable(
        self, raw: Samples, grown: Region, inside: Region, info: FrameInfo, unknown: NDArray[np.bool_] | None
    ) -> tuple[NDArray[np.bool_] | None, int | None]:
        """Return a map of the valid samples in ``inside`` (None: all), and the number of saturated ones."""
        if raw.valid is None:
            return None if unknown is None else ~unknown, raw.saturated
        valid = np.array(raw.valid)
        # a repaired pixel is the mean of its neighbours, so its raw value no longer counts
        repaired = self.chain.repaired(self._placed(grown, info))
        valid[repaired[:, 0], repaired[:, 1]] = True
        bad = ~valid[part_of(inside, grown)]
        # masked pixels are not valid either, but are unrelated to saturation
        full = bad if info.mask is None else bad & info.mask[inside]
        if unknown is not None:
            full, bad = full & ~unknown, bad | unknown
        count = None if raw.saturated is None else int(np.count_nonzero(full))
        return (~bad if bad.any() else None), count

    def _noise(self, noise: Noise | None, inside: Region, info: FrameInfo, level: float) -> Noise | None:
        """Return the noise of the corrected samples; ``level`` is the subtracted background."""
        if noise is None:
            return None
        return corrected_noise(noise, self.chain, self._placed(inside, info), info.exposure_s, level)

    def _placed(self, region: Region, info: FrameInfo) -> Region:
        """Return a region of a frame in the coordinates of the calibration frames."""
        return moved(region, (info.origin[0] - self._first[0], info.origin[1] - self._first[1]))


def corrected(source: FrameSource, chain: CorrectionChain) -> CorrectedSource:
    """Return a view of ``source`` whose frames are corrected by ``chain`` when they are read.

    Raises
    ------
    InputError
        If the shapes of the calibration frames and of the frames differ.

    Examples
    --------
    >>> from lfcal.frames import CorrectedSource, CorrectionChain, Dark, corrected, open_frames
    >>> with open_frames("session/frames") as source:
    ...     clean: CorrectedSource = corrected(source, CorrectionChain((Dark(level=64.0),)))
    ...     print(source.read(0)[40, 48], "less 64 is", clean.read(0)[40, 48])
    67 less 64 is 3.0
    """
    return CorrectedSource(source, chain)


MIN_READ_SHARE = 0.25
"""Smallest fraction of the read noise's variance that remains: the dark's noise must not make a variance negative."""


def corrected_noise(
    raw: Noise, chain: CorrectionChain, region: Region, exposure_s: float | None, background: float = 0.0
) -> Noise:
    """Return the noise of samples corrected by ``chain``.

    A raw sample r has the variance ``c + s max(r - black, 0)``. The corrected sample is ``v = (r - d) w f - b``. Here d
    is the dark, of variance e; w and f are the factors of the white image and of the exposure, and b is the background.
    Its variance is ``(w f)^2 (c + s (d - black) + e) + w f s (v + b)``. The term e is
    included only if the number of averaged dark frames is known. If the black level is unknown, the median of the dark
    frame replaces it.

    Parameters
    ----------
    raw
        Noise of the raw samples.
    chain, region, exposure_s
        The corrections, the sensor region, and the exposure of the frame (s).
    background
        Background subtracted at the end (corrected sample values).
    """
    constant: Number = raw.constant
    dark = chain.dark_at(exposure_s)
    black = raw.black
    if dark is not None:
        frame = dark.part(region)
        if frame is not None:
            held = frame.astype(np.float64) + dark.level
            # signal in the dark frame: dark current and hot pixels have photon noise too
            shown = held - (float(np.median(held)) if black is None else black)
            constant = np.maximum(constant + raw.slope * shown, MIN_READ_SHARE * np.asarray(raw.constant))
            constant = constant * (1 + 1 / dark.count) if dark.count else constant
        black = 0.0
    gain = chain.gain(region)
    factor: Number = chain.factor(exposure_s) if gain is None else gain * chain.factor(exposure_s)
    slope = raw.slope * factor
    kept = None if black is None else black * chain.factor(exposure_s) - background
    if dark is not None or not kept:
        return Noise(constant * factor**2 + slope * max(background, 0.0), slope)
    return Noise(constant * factor**2, slope, kept)
