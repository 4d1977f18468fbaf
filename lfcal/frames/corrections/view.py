"""A frame source seen through a correction chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError, LfcalError
from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.delegate import SourceView
from lfcal.frames.regions import Region, check_region, grow_region, read_region, whole
from lfcal.frames.source import FrameSource
from lfcal.frames.stack import frame_exposure

__all__ = ["CorrectedSource", "corrected"]


class CorrectedSource(SourceView):
    """Corrected float32 frames of ``source``; a region costs no more than the region and its margin."""

    def __init__(self, source: FrameSource, chain: CorrectionChain) -> None:
        if chain.shape is not None and chain.shape != source.shape:
            raise InputError.expected(
                "frames",
                f"shape {chain.shape} of the calibration frames",
                source.shape,
                "take frames, dark and white with one sensor setting",
            )
        if chain.saturation is None and source.metadata.get("saturation") is not None:
            chain = replace(chain, saturation=float(source.metadata["saturation"]))
        super().__init__(source)
        self.chain = chain

    @property
    def dtype(self) -> np.dtype[Any]:
        """float32."""
        return np.dtype(np.float32)

    @property
    def metadata(self) -> Mapping[str, Any]:
        """The raw frames' metadata with the ``corrections`` described."""
        return {**self.source.metadata, "corrections": self.chain.describe()}

    def read(self, index: int) -> NDArray[np.float32]:
        """Return frame ``index`` corrected."""
        return self.read_counted(index, *whole(self.shape))[0]

    def read_region(self, index: int, rows: slice, columns: slice) -> NDArray[np.float32]:
        """Return the part ``[rows, columns]`` of frame ``index``, equal to that of the whole corrected frame."""
        return self.read_counted(index, rows, columns)[0]

    def read_counted(self, index: int, rows: slice, columns: slice) -> tuple[NDArray[np.float32], int]:
        """Return a corrected part of frame ``index`` and how many of its raw pixels are saturated.

        Raises
        ------
        InputError
            With the frame's name, if it cannot be read or corrected.
        """
        inside = check_region((rows, columns), self.shape)
        grown = grow_region(inside, self.chain.margin, self.shape)
        exposure = frame_exposure(self.source, index)
        part = read_region(self.source, index, *grown)
        try:
            plane = self._background(index, part, grown, exposure)
            clean = self.chain.apply_region(part, grown, inside=inside, exposure_s=exposure, background=plane)
        except LfcalError as error:
            raise type(error)(f"{self.label(index)}: {error}") from error
        (r, c), (ir, ic) = grown, inside
        raw = part[ir.start - r.start : ir.stop - r.start, ic.start - c.start : ic.stop - c.start]
        return clean, self.chain.saturated(raw, inside)

    def _background(
        self, index: int, part: NDArray[Any], known: Region, exposure: float | None
    ) -> tuple[float, float, float] | None:
        """Return the background of frame ``index``; reads its border only where ``part`` does not hold it."""
        if not self.chain.measures_frames:
            return None

        def read(region: Region) -> NDArray[Any]:
            if known == whole(self.shape):
                return part[region]
            return read_region(self.source, index, *region)

        return self.chain.measure(read, self.shape, exposure_s=exposure)


def corrected(source: FrameSource, chain: CorrectionChain) -> CorrectedSource:
    """Return the frames of ``source`` as ``chain`` corrects them, again a `FrameSource`.

    Raises
    ------
    InputError
        If the calibration frames of the chain have another shape.
    """
    return CorrectedSource(source, chain)
