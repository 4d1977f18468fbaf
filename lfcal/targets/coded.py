"""Coded frames that show points of several offsets together, and their decoding into single offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Region
from lfcal.frames import FrameInfo, FrameMetadata, FrameSource, Noise, Samples, SourceView
from lfcal.targets.plan import TargetPlan, lit_blocks, lit_matrix

__all__ = ["DecodedFrames", "decoded"]

F8 = NDArray[np.float64]


class DecodedFrames(SourceView):
    """Source of frames of single offsets, decoded from frames that each show several offsets together.

    Each decoded frame is a weighted sum of recorded frames of its plane, with the noise of the sum. For an S-matrix of
    order n, the variance of this noise at a pixel is 4n/(n + 1)² times the variance without light. To this is added
    2/(n + 1) times the sum of the photon-noise variances of all n patterns.

    Parameters
    ----------
    source
        Recorded frames with their dark level subtracted, in the order of the plan.
    plan
        Plan of a target with switchable points (`TargetPlan.lit`).

    Raises
    ------
    InputError
        If the plan does not show several offsets together, or its number of frames differs from that of the source.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.multiplex import s_matrix
    >>> from lfcal.targets import DecodedFrames, Target, TargetPlan, coded_plan
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> offsets = (((0.0, 0.0), (0.0, 5.0), (5.0, 0.0)),)
    >>> plan = coded_plan(TargetPlan(scan, Target(), offsets, 0.1, (0.0,), "geometric"), s_matrix(3), pixel_um=8.0)
    >>> print(plan.lit[0])
    ((0, 1), (0, 2), (1, 2))
    >>> sums = np.array([101.0, 110.0, 11.0])[:, None, None] * np.ones((1, 320, 320))
    >>> frames = DecodedFrames(ArraySource(sums, [(0, 0, k) for k in range(3)]), plan)
    >>> print([round(float(frames.read(k)[0, 0]), 3) for k in range(3)])
    [100.0, 1.0, 10.0]
    """

    def __init__(self, source: FrameSource, plan: TargetPlan) -> None:
        super().__init__(source)
        if plan.lit is None or len(source) != len(plan.frames):
            wanted = f"{len(plan.frames)} frames of a plan that shows several offsets together"
            raise InputError.expected("coded frames", wanted, len(source), "give all frames, and their plan")
        self._weights: list[F8] = []
        self._shown: list[F8] = []
        for z, plane in enumerate(plan.lit):
            shown = lit_matrix(plane, len(plan.offsets_px[z]))
            self._shown.append(shown)
            inverse = np.zeros_like(shown)
            for rows, columns in lit_blocks(plane, len(shown)):
                inverse[np.ix_(columns, rows)] = np.linalg.inv(shown[np.ix_(rows, columns)])
            self._weights.append(inverse)
        self._frames = plan.frames
        self._first = {z: k for k, (z, at) in reversed(list(enumerate(plan.frames))) if at == 0}

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type, float32, because frames are weighted sums."""
        return np.dtype(np.float32)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known``, marked as decoded, without saturation and bit depth, which no longer apply."""
        return replace(known, saturation=None, bit_depth=None, decoded=True)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``, combined from the recorded frames from which it is decoded."""
        parts = [self.source.info(k) for k, _, _ in self._parts(index)]
        masks = [one.mask for one in parts if one.mask is not None]
        counts = [one.saturated for one in parts]
        saturated = None if any(count is None for count in counts) else sum(filter(None, counts))
        own = self.source.info(index)
        z, k = self._frames[index]
        label = f"offset {k} of plane {z}, of {len(parts)} frames"
        mask = np.logical_and.reduce(masks) if masks else None
        return FrameInfo((), own.origin, own.exposure_s, None, saturated, label, mask)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index`` decoded to a single offset, or its ``region`` (row and column slices)."""
        parts = self._parts(index)
        return sum(np.float32(w) * np.asarray(self.source.read(k, region), np.float32) for k, w, _ in parts)  # type: ignore[return-value]

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the decoded samples of frame ``index`` or of its ``region`` (row and column slices), with their noise.

        A sample is valid if it is valid in all summed frames.
        """
        parts = [(self.source.samples(k, region), w, shown) for k, w, shown in self._parts(index)]
        values = sum(w * np.asarray(one.values, np.float64) for one, w, _ in parts)
        masks = [one.valid for one, _, _ in parts if one.valid is not None]
        valid = np.logical_and.reduce(masks) if masks else None
        counts = [one.saturated for one, _, _ in parts]
        saturated = None if any(count is None for count in counts) else sum(filter(None, counts))
        return Samples(np.asarray(values, np.float32), valid, _noise(parts, np.asarray(values)), saturated)

    def _parts(self, index: int) -> list[tuple[int, float, float]]:
        """Return the frames in the sum, each with its weight and whether it shows the offset."""
        z, m = self._frames[index]
        weights, shown, first = self._weights[z][m], self._shown[z][:, m], self._first[z]
        # drop weights of frames in other groups, which are rounding errors
        used = np.flatnonzero(np.abs(weights) > 1e-9 * np.abs(weights).max())
        return [(first + int(f), float(weights[f]), float(shown[f])) for f in used]


def _noise(parts: Sequence[tuple[Samples, float, float]], values: F8) -> Noise | None:
    """Return the noise of a decoded offset; the light of the other offsets is part of its constant variance."""
    total, slope = np.zeros(values.shape), 0.0
    for one, w, shown in parts:
        if one.noise is None:
            return None
        total += w * w * one.noise.variance(np.asarray(one.values, np.float64))
        slope += w * w * shown * float(np.mean(one.noise.slope))
    return Noise(np.maximum(total - slope * np.maximum(values, 0.0), 0.0), slope)


def decoded(source: FrameSource, plan: TargetPlan) -> FrameSource:
    """Return a source of frames of single offsets; ``source`` itself if frames of ``plan`` show single offsets.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.multiplex import s_matrix
    >>> from lfcal.targets import Target, TargetPlan, coded_plan, decoded
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> single = TargetPlan(scan, Target(), (((0.0, 0.0), (0.0, 5.0), (5.0, 0.0)),), 0.1, (0.0,), "geometric")
    >>> frames = np.array([101.0, 110.0, 11.0])[:, None, None] * np.ones((1, 320, 320))
    >>> source = ArraySource(frames, [(0, 0, k) for k in range(3)])
    >>> for plan in (single, coded_plan(single, s_matrix(3), pixel_um=8.0)):  # frame 0 shows offset 0; offsets 0 and 1
    ...     print([round(float(decoded(source, plan).read(k)[0, 0]), 3) for k in range(3)])
    [101.0, 110.0, 11.0]
    [100.0, 1.0, 10.0]
    """
    return source if plan.lit is None else DecodedFrames(source, plan)
