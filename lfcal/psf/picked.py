"""An H that contains the patterns of only a few positions of a scan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work
from lfcal.camera import ScanPlan
from lfcal.frames import FrameSource
from lfcal.psf._planes import Planes, TransposedPlanes
from lfcal.psf.cutout import Cutout, Gatherer, by_position
from lfcal.psf.facts import Facts, pack_valid, packed_bytes
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.provenance import FrameNoise

__all__ = ["PickedPlanes", "iter_pick"]

Place = tuple[int, int, int]


class PickedPlanes:
    """Planes with only some patterns; the other patterns are zero and take no memory.

    Parameters
    ----------
    shape
        Shape ``(nz, ny, nx, nt, ns)`` of the matrix.
    patterns
        Pattern ``(nt, ns)`` of each selected position (z, y, x).
    """

    def __init__(self, shape: tuple[int, int, int, int, int], patterns: Mapping[Place, NDArray[np.float32]]) -> None:
        self.shape = shape
        self.dtype = np.dtype(np.float32)
        self._patterns = dict(patterns)

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as a new array ``(ny, nx, nt, ns)``."""
        out = np.zeros(self.shape[1:], np.float32)
        for (own, y, x), pattern in self._patterns.items():
            if own == z:
                out[y, x] = pattern
        return out

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return the pattern ``(nt, ns)`` of one position; zeros if it is not among the selected ones."""
        found = self._patterns.get((z, y, x))
        return np.zeros(self.shape[3:], np.float32) if found is None else found

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)


def iter_pick(
    source: FrameSource, plan: ScanPlan, positions: NDArray[np.intp], *, noise: FrameNoise | None = None
) -> Work[PSFMatrix]:
    """Assemble the patterns of selected positions into a matrix; yield progress in positions.

    Pixels of a cutout beyond the frame are marked as invalid.

    Parameters
    ----------
    source
        Corrected frames, which are used unchanged. Only those of ``positions`` are read.
    plan
        Scan plan, which states the shape of the scan, the depths, the anchor and the cutout.
    positions
        Indices (z, y, x) of the positions, ``(n, 3)``.
    noise
        Noise of the samples, for frames that do not state it. None: unknown for these.

    Raises
    ------
    InputError
        If one of ``positions`` has no frame, a frame is at a position outside the plan, or a cutout is completely
        outside its frame.
    """
    infos = tuple(source.info(k) for k in range(len(source)))
    order, starts = by_position(infos, plan.shape[:3])
    gatherer = Gatherer(source, infos, Cutout.for_plan(plan, outside="zero"), noise=noise.of_samples if noise else None)
    shape = plan.shape[:3]
    recorded = np.zeros(shape, np.uint16)
    variances = np.full((*shape, 2), np.nan, np.float32)
    saturated = np.full(shape, -1, np.int32)
    masks: dict[Place, NDArray[np.uint8]] = {}
    patterns: dict[Place, NDArray[np.float32]] = {}
    clock = Clock("cut out patterns", len(positions))
    yield clock.at(0)
    for done, at in enumerate(map(tuple, np.asarray(positions, np.intp).tolist()), 1):
        place: Place = (at[0], at[1], at[2])
        if not all(0 <= k < n for k, n in zip(place, shape, strict=True)):
            raise InputError.expected(
                "position (z, y, x)", f"three numbers from 0, below {shape}", place, "choose a position of the plan"
            )
        flat = int(np.ravel_multi_index(place, shape))
        own = order[starts[flat] : starts[flat + 1]]
        if not len(own):
            raise InputError.expected(
                "position (z, y, x)", "a position that has a frame", place, "choose another position"
            )
        found = gatherer.pattern(own)
        patterns[place] = found.values
        recorded[place], variances[place], saturated[place] = len(own), found.noise, found.saturated
        if found.valid is not None:
            masks[place] = pack_valid(found.valid)
        yield clock.at(done)
    valid = np.full((*shape, packed_bytes(plan.cutout)), 255, np.uint8) if masks else None
    for place, mask in masks.items():
        assert valid is not None
        valid[place] = mask
    facts = Facts.of(shape, plan.cutout, recorded=recorded, noise=variances, saturated=saturated, valid=valid)
    return PSFMatrix(
        PickedPlanes(plan.shape, patterns),
        depths=plan.depths_um,
        camera=plan.camera,
        anchor=plan.anchor,
        facts=facts,
        provenance=source.metadata.stated(("optics",)) | ({} if noise is None else {"noise": noise.record()}),
    )
