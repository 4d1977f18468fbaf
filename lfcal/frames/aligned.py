"""Samples that fill their type from the top: a camera's 12 bits in the upper bits of 16."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.checks import check_number
from lfcal.errors import InputError
from lfcal.frames.regions import Region
from lfcal.frames.source import Frames, FrameSource, Samples
from lfcal.frames.view import SourceView

__all__ = ["ShiftedSource", "shifted"]


def shifted(values: NDArray[Any], bits: int, what: str) -> NDArray[Any]:
    """Return integer ``values`` moved down by ``bits``; raises `InputError` if the bits dropped hold anything."""
    if values.dtype.kind not in "iu":
        raise InputError.expected(f"{what}, samples to shift", "integers", values.dtype, "leave the shift out")
    if np.any(values & values.dtype.type((1 << bits) - 1)):
        raise InputError.expected(
            what, f"samples with {bits} empty low bits", "bits in use", "correct the shift, or leave it out"
        )
    moved: NDArray[Any] = values >> values.dtype.type(bits)
    return moved


class ShiftedSource(SourceView):
    """Left-aligned samples moved down by ``bits``, to the values that the camera's converter gave."""

    def __init__(self, source: FrameSource, bits: int) -> None:
        super().__init__(source)
        check_number("shift of the samples (bits)", bits, at_least=1, at_most=15, integer=True)
        self.bits = bits

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of the frames, with the shift; levels of the shifted type no longer hold."""
        known = {k: v for k, v in self.source.metadata.items() if k not in ("bit_depth", "saturation", "black_level")}
        if "noise" in known:
            known["noise"] = known["noise"].scaled(0.5**self.bits)
        return known | {"shift": self.bits}

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or a part of it."""
        return shifted(self.source.read(index, region), self.bits, self.info(index).label)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the shifted samples."""
        return Frames.samples(self, index, region)
