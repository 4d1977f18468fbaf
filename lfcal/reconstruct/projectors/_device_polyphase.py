"""Polyphase projection on a device: transforms of overlap-save tiles, and a product per frequency.

The arithmetic is that of `lfcal.reconstruct.projectors._polyphase`, whose spectra of H are used unchanged.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors._device_engine import DeviceEngine, DeviceOperand, Placement
from lfcal.reconstruct.projectors._polyphase import Polyphase
from lfcal.reconstruct.projectors._tiles import TilePlan

__all__ = ["DevicePolyphase", "band_bytes"]


def band_bytes(plan: TilePlan, rows: int, itemsize: int) -> int:
    """Return the working memory (bytes) of ``rows`` rows of tiles, with real numbers of ``itemsize`` bytes."""
    tiles = rows * plan.x.count
    windows = plan.y.length * plan.x.length * tiles * plan.grid.phases * itemsize
    spectra = plan.frequencies * tiles * plan.grid.phases * 2 * itemsize
    # windows along one axis and along both, and the temporary memory of a transform
    return 3 * windows + 3 * spectra


class DevicePolyphase(DeviceEngine):
    """Polyphase projection on a device with the tiles in ``plan``; see `projectors._polyphase.Polyphase`."""

    name = "polyphase"
    any_phases = False

    def __init__(
        self,
        plan: TilePlan,
        dtype: np.dtype[Any],
        placement: Placement,
        workers: int | None = None,
        phases: NDArray[np.bool_] | None = None,
    ) -> None:
        super().__init__(plan.grid, dtype, placement)
        self.plan = plan
        self.host = Polyphase(plan.grid, plan, dtype, workers, phases)
        self.rounding = self.host.rounding
        one = band_bytes(plan, 1, dtype.itemsize)
        step = max(1, min(plan.counts[0], placement.room // one))
        self.bands = [(k, min(k + step, plan.counts[0])) for k in range(0, plan.counts[0], step)]
        selected, n = self.host.selected, plan.grid.phases
        self.which: Any = None
        if len(selected) < n:
            # index of each phase among the selected ones; all others use the zeros behind them
            places = np.full(n, len(selected), np.int64)
            places[selected] = np.arange(len(selected))
            with self.device.active():
                self.which, self.places = self.device.moved(selected.astype(np.int64)), self.device.moved(places)

    def prepared(self, plane: NDArray[Any]) -> tuple[tuple[NDArray[Any], ...], Any]:
        """Return the spectra ``(fx, fy, source phase, image phase)``."""
        return (self.host.prepare(plane),), None

    def add(self, total: list[Any] | None, operand: DeviceOperand, plane: Any) -> list[Any]:
        """Return ``total`` plus the image's spectra for a volume plane, ``(fx, fy, tiles, phases)`` for each band."""
        cells, (spectra,) = self._cells(plane), operand.arrays
        found = [] if total is None else total
        for k, band in enumerate(self.bands):
            product = self.device.xp.matmul(self._spectrum(cells, band), spectra)
            if total is None:
                found.append(product)
            else:
                found[k] += product
        return found

    def image(self, total: list[Any]) -> Any:
        """Return the image from its spectra of all bands."""
        cells = [self._valid(spectrum, band) for spectrum, band in zip(total, self.bands, strict=True)]
        return self._plane(self._all_phases(self.device.xp.concat(cells, axis=1)))

    def seen(self, image: Any) -> list[Any]:
        """Return the conjugate spectra ``(fx, fy, tiles, selected phases)`` of all bands."""
        xp, cells = self.device.xp, self._cells(image)
        if self.which is not None:
            cells = xp.take(cells, self.which, axis=2)
        return [xp.conj(self._spectrum(cells, band)) for band in self.bands]

    def back(self, seen: list[Any], operand: DeviceOperand) -> Any:
        """Return the back projection of conjugate spectra on one plane."""
        xp, (spectra,) = self.device.xp, operand.arrays
        turned = xp.matrix_transpose(spectra)
        # conj(conj(f) K^T) is f times the conjugate of K^T, so the operand needs no rearrangement
        parts = (xp.conj(xp.matmul(spectrum, turned)) for spectrum in seen)
        cells = [self._valid(part, band) for part, band in zip(parts, self.bands, strict=True)]
        return self._plane(xp.concat(cells, axis=1))

    # -- steps -----------------------------------------------------------------------------------------
    def _cells(self, plane: Any) -> Any:
        """Return ``plane`` as lattice cells with the tiles' margins, ``(Px, Py, phases)``."""
        (ny, nx), (cy, cx), y, x = self.grid.period, self.grid.cells, self.plan.y, self.plan.x
        before = (y.lead * ny, x.lead * nx)
        after = ((y.padded - y.lead - cy) * ny, (x.padded - x.lead - cx) * nx)
        xp, packed = self.device.xp, self.packed(plane, before, after)
        cells = xp.permute_dims(xp.reshape(packed, (y.padded, ny, x.padded, nx)), (2, 0, 1, 3))
        return xp.reshape(cells, (x.padded, y.padded, ny * nx))

    def _spectrum(self, cells: Any, band: tuple[int, int]) -> Any:
        """Return the spectra of a band's tiles, ``(fx, fy, tiles, phases)``."""
        xp, x, y = self.device.xp, self.plan.x, self.plan.y
        slabs = xp.stack([cells[k * x.valid : k * x.valid + x.taken, :, :] for k in range(x.count)], axis=2)
        rows = [slabs[:, k * y.valid : k * y.valid + y.taken, :, :] for k in range(*band)]
        windows = xp.stack(rows, axis=2)
        tiles = (band[1] - band[0]) * x.count
        windows = xp.reshape(windows, (x.taken, y.taken, tiles, cells.shape[2]))
        # the columns' spectrum is halved; a single tile is padded with zeros to the length of its transform
        return xp.fft.rfftn(windows, s=(y.length, x.length), axes=(1, 0))

    def _valid(self, spectra: Any, band: tuple[int, int]) -> Any:
        """Return the valid cells of a band's tiles, ``(columns, rows, phases)``."""
        xp, x, y = self.device.xp, self.plan.x, self.plan.y
        windows = xp.fft.irfftn(spectra, s=(y.length, x.length), axes=(1, 0))
        inside = windows[x.lead : x.lead + x.valid, y.lead : y.lead + y.valid, :, :]
        down, phases = band[1] - band[0], spectra.shape[3]
        apart = xp.permute_dims(xp.reshape(inside, (x.valid, y.valid, down, x.count, phases)), (3, 0, 2, 1, 4))
        return xp.reshape(apart, (x.count * x.valid, down * y.valid, phases))

    def _all_phases(self, cells: Any) -> Any:
        if self.which is None:
            return cells
        xp = self.device.xp
        nothing = self.device.zeros((cells.shape[0], cells.shape[1], 1), self.dtype)
        return xp.take(xp.concat([cells, nothing], axis=2), self.places, axis=2)

    def _plane(self, cells: Any) -> Any:
        """Return the plane ``(Y, X)`` of cells ``(Lx, Ly, phases)``."""
        xp, (ny, nx), (cy, cx) = self.device.xp, self.grid.period, self.grid.cells
        whole = xp.permute_dims(xp.reshape(cells[:cx, :cy, :], (cx, cy, ny, nx)), (1, 2, 0, 3))
        return self.grid.unpack(xp.reshape(whole, (cy * ny, cx * nx)))
