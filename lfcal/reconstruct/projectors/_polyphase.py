"""Polyphase projection: H as a block-Toeplitz matrix over the lattice of whole periods.

Split image and volume by phase, ``p = n P + i`` and ``v = n V + j``. Then ::

    f_i[P] = sum_j sum_D K_ij[D] g_j[P - D],      K_ij[D] = H[j][n D + i - j + c]

is, at each frequency of the coarse lattice, one product with the small matrix ``K_ij`` of all phases. The lattice is
divided into overlap-save tiles, so that the spectra of H stay small and every product has one column per tile.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_block, for_each_chunk, one_blas_thread, worker_count
from lfcal.reconstruct.projectors._tiles import TilePlan
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["Polyphase"]

PARTS, COLUMNS = 16, 512
"""Largest number of blocks of lattice rows, and smallest number of columns in a product of a block."""


class Polyphase:
    """Project with one small matrix product per frequency of the lattice of whole periods.

    Parameters
    ----------
    grid
        Image, period and cutout.
    plan
        Tiles.
    dtype
        float32 (complex64 spectra) or float64 (complex128).
    workers
        Number of threads. None: all processors.
    phases
        ``(ny, nx)`` mask of the image phases to compute and to use. None: all.
    band
        Rows of tiles processed together; fewer need less memory.
    """

    name = "polyphase"
    any_phases = False

    def __init__(
        self,
        grid: Grid,
        plan: TilePlan,
        dtype: np.dtype[Any],
        workers: int | None = None,
        phases: NDArray[np.bool_] | None = None,
        band: int | None = None,
    ) -> None:
        self.grid = grid
        self.plan = plan
        self.dtype = dtype
        self.complex = np.result_type(dtype, np.complex64)
        self.workers = worker_count(workers)
        self.selected = np.arange(grid.phases) if phases is None else np.flatnonzero(phases.ravel())
        self.all_phases = np.arange(grid.phases)
        self.band = plan.counts[0] if band is None else max(1, min(band, plan.counts[0]))
        self.rounding = 20 * float(np.finfo(dtype).eps)
        self.matrices = plan.matrices(self.complex)

    # -- operand ---------------------------------------------------------------------------------------
    def prepare(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the spectra of H, ``(fx, fy, source phase, image phase)``."""
        n, m = self.grid.phases, len(self.selected)
        fx, fy = self.plan.x.frequencies, self.plan.y.frequencies
        out = np.empty((fx, fy, n, m), self.complex)
        flat = out.reshape(fx, fy, n * m)
        step = max(1, (1 << 19) // (m * fx * (2 * self.grid.reach[0] + 1)))  # so that the taps fit in the caches
        step = min(step, -(-n // PARTS))

        def transform(start: int, stop: int) -> None:
            taps = self._taps(plane, start, stop)  # (kx, ky, sources, pixels)
            kx, ky = taps.shape[:2]
            along_x = self.matrices["kernel_x"] @ taps.reshape(kx, -1).astype(self.complex)
            part = flat[:, :, start * m : stop * m]
            np.matmul(self.matrices["kernel_y"], along_x.reshape(fx, ky, -1), out=part)

        # many small products in parallel, for which threads of BLAS would be slower
        with one_blas_thread():
            for_each_block(transform, n, step, self.workers)
        return out

    def operand_bytes(self, operand: NDArray[Any]) -> int:
        """Return the size of the spectra (bytes)."""
        return operand.nbytes

    def _taps(self, plane: NDArray[Any], start: int, stop: int) -> NDArray[Any]:
        """Return ``K[Dx, Dy, j, i]`` for source phases ``start <= j < stop`` and the selected image phases."""
        (ny, nx), (ry, rx), (cy, cx) = self.grid.period, self.grid.reach, self.grid.centre
        nt, ns = self.grid.cutout
        ky, kx = 2 * ry + 1, 2 * rx + 1
        taps = np.empty((kx, ky, stop - start, len(self.selected)), self.dtype)
        for j in range(start, stop):
            y, x = divmod(j, nx)
            top, left = y - cy + ry * ny, x - cx + rx * nx
            t, s = _inside(top, nt, ky * ny), _inside(left, ns, kx * nx)
            frame = np.zeros((ky * ny, kx * nx), self.dtype)
            frame[top + t.start : top + t.stop, left + s.start : left + s.stop] = plane[y, x, t, s]
            # a pattern, placed by its centre among whole cells, splits into taps K[D] by image phase
            cells = frame.reshape(ky, ny, kx, nx).transpose(2, 0, 1, 3).reshape(kx, ky, -1)
            taps[:, :, j - start] = cells if len(self.selected) == self.grid.phases else cells[:, :, self.selected]
        return taps

    # -- the pair --------------------------------------------------------------------------------------
    def forward(self, planes: Iterable[tuple[NDArray[Any], NDArray[Any]]]) -> NDArray[Any]:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        bands = self._bands()
        totals: list[NDArray[Any] | None] = [None] * len(bands)
        with one_blas_thread():
            for operand, plane in planes:
                packed = self._pack(plane)
                for k, band in enumerate(bands):
                    slabs = self._analyse_x(packed, self.all_phases, band, conjugate=False)
                    totals[k] = self._spread(slabs, operand, totals[k])
            if totals[0] is None:  # all planes are zero
                return np.zeros(self.grid.image_shape, self.dtype)
            cells = self._cells(self.selected)
            for total, band in zip(totals, bands, strict=True):
                if total is not None:
                    self._synthesise_x(self._synthesise_y(total), band, cells, self.selected, conjugate=False)
        return self._image(cells)

    def adjoint(self, image: NDArray[Any], operands: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
        """Yield the back projection of ``image`` for each operand."""
        bands = self._bands()
        packed = self._pack(image)
        spectra: list[NDArray[Any]] = []
        for operand in operands:
            cells = self._cells(self.all_phases)
            with one_blas_thread():
                if not spectra:  # compute the image's spectra once for all planes
                    slabs = (self._analyse_x(packed, self.selected, band, conjugate=True) for band in bands)
                    spectra = [self._spread(slab, None, None) for slab in slabs]
                for spectrum, band in zip(spectra, bands, strict=True):
                    collected = self._synthesise_y(spectrum, operand)
                    self._synthesise_x(collected, band, cells, self.all_phases, conjugate=True)
            yield self._image(cells)

    # -- steps -----------------------------------------------------------------------------------------
    def _bands(self) -> list[tuple[int, int]]:
        count = self.plan.counts[0]
        return [(k, min(k + self.band, count)) for k in range(0, count, self.band)]

    def _pack(self, plane: NDArray[Any]) -> NDArray[Any]:
        """Return ``plane`` as lattice cells with the tiles' margins, ``(Px, Py, ny, nx)`` as a view."""
        (ny, nx), (cy, cx), y, x = self.grid.period, self.grid.cells, self.plan.y, self.plan.x
        before = (y.lead * ny, x.lead * nx)
        after = ((y.padded - y.lead - cy) * ny, (x.padded - x.lead - cx) * nx)
        packed = self.grid.pack(plane, self.dtype, before=before, after=after)
        return packed.reshape(y.padded, ny, x.padded, nx).transpose(2, 0, 1, 3)

    def _columns(self, packed: NDArray[Any], phases: NDArray[np.intp]) -> NDArray[Any]:
        """Return cells ``(Px, rows, ny, nx)`` as complex columns ``(Px, rows * phases)``."""
        if len(phases) < self.grid.phases:
            packed = packed.reshape(*packed.shape[:2], -1)[..., phases]
        columns = np.empty(packed.shape, self.complex)
        columns[...] = packed
        return columns.reshape(len(columns), -1)

    def _analyse_x(
        self, packed: NDArray[Any], phases: NDArray[np.intp], band: tuple[int, int], *, conjugate: bool
    ) -> NDArray[Any]:
        """Return the tile columns ``(tiles in x, fx, rows, phases)`` of a band of tile rows, transformed along x.

        The adjoint needs products with the complex conjugate of K. As data are real, it reverses the sign of the
        transform instead (``conjugate``), also of those along y until `_synthesise_x`.
        """
        x, y = self.plan.x, self.plan.y
        first, rows = band[0] * y.valid, (band[1] - band[0] - 1) * y.valid + y.taken
        along = self.matrices["analysis_x"].conj() if conjugate else self.matrices["analysis_x"]
        slabs = np.empty((x.count, x.frequencies, rows, len(phases)), self.complex)

        def transform(start: int, stop: int) -> None:
            columns = self._columns(packed[:, first + start : first + stop], phases)
            inside = slice(start * len(phases), stop * len(phases))
            for k in range(x.count):
                window = columns[k * x.valid : k * x.valid + x.taken]
                np.matmul(along, window, out=slabs[k].reshape(x.frequencies, -1)[:, inside])

        for_each_block(transform, rows, _step(rows, len(phases)), self.workers)
        return slabs

    def _spread(self, slabs: NDArray[Any], operand: NDArray[Any] | None, total: NDArray[Any] | None) -> NDArray[Any]:
        """Return the tiles' spectra ``(fx, fy, tiles, phases)``, times ``operand`` and added to ``total`` if given."""
        x, y = self.plan.x, self.plan.y
        count, phases = (slabs.shape[2] - y.taken) // y.valid + 1, slabs.shape[3]
        along = self.matrices["analysis_y"] if operand is not None else self.matrices["analysis_y"].conj()
        tiles = (count, x.count)
        wide = phases if operand is None else operand.shape[3]
        out = np.empty((x.frequencies, y.frequencies, count * x.count, wide), self.complex) if total is None else total

        def work(start: int, stop: int) -> None:
            for f in range(start, stop):
                own = np.empty((y.frequencies, *tiles, phases), self.complex) if operand is not None else None
                spectrum = out[f].reshape(y.frequencies, *tiles, phases) if own is None else own
                for k in range(count):
                    window = slabs[:, f, k * y.valid : k * y.valid + y.taken]
                    np.matmul(along, window, out=spectrum[:, k].swapaxes(0, 1))
                if operand is None:
                    continue
                flat = spectrum.reshape(y.frequencies, -1, phases)
                if total is None:
                    np.matmul(flat, operand[f], out=out[f])
                else:
                    out[f] += np.matmul(flat, operand[f])

        for_each_chunk(work, x.frequencies, self.workers)
        return out

    def _synthesise_y(self, spectrum: NDArray[Any], operand: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return tile columns ``(tiles in x, fx, rows, phases)`` of spectra, multiplied by ``operand`` if given."""
        x, y = self.plan.x, self.plan.y
        count = spectrum.shape[2] // x.count
        phases = spectrum.shape[3] if operand is None else operand.shape[2]
        along = self.matrices["synthesis_y"] if operand is None else self.matrices["synthesis_y"].conj()
        slabs = np.empty((x.count, x.frequencies, count * y.valid, phases), self.complex)

        def work(start: int, stop: int) -> None:
            for f in range(start, stop):
                if operand is not None:
                    # K times a transposed view is faster than that times K transposed; phases come before tiles then.
                    turned = np.matmul(operand[f], spectrum[f].swapaxes(1, 2)).reshape(y.frequencies, -1)
                    valid = (along @ turned).reshape(y.valid, phases, count, x.count)
                    slabs[:, f].reshape(x.count, count, y.valid, phases)[...] = valid.transpose(3, 2, 0, 1)
                    continue
                tiles = spectrum[f].reshape(y.frequencies, count, x.count, phases)
                for k in range(count):
                    rows = slice(k * y.valid, (k + 1) * y.valid)
                    np.matmul(along, tiles[:, k].swapaxes(0, 1), out=slabs[:, f, rows])

        for_each_chunk(work, x.frequencies, self.workers)
        return slabs

    def _synthesise_x(
        self,
        slabs: NDArray[Any],
        band: tuple[int, int],
        cells: NDArray[Any],
        phases: NDArray[np.intp],
        *,
        conjugate: bool,
    ) -> None:
        """Write the valid cells of a band's tiles into ``cells`` ``(Lx, Ly, phases)``."""
        x, y = self.plan.x, self.plan.y
        along = self.matrices["synthesis_x"].conj() if conjugate else self.matrices["synthesis_x"]

        def transform(start: int, stop: int) -> None:
            rows = slice(band[0] * y.valid + start, band[0] * y.valid + stop)
            for k in range(x.count):
                part = along @ slabs[k, :, start:stop].reshape(x.frequencies, -1)
                block = part.real.reshape(x.valid, stop - start, -1)
                columns = slice(k * x.valid, (k + 1) * x.valid)
                if len(phases) == self.grid.phases:
                    cells[columns, rows] = block
                else:
                    cells[columns, rows, phases] = block

        for_each_block(transform, slabs.shape[2], _step(slabs.shape[2], len(phases)), self.workers)

    def _cells(self, phases: NDArray[np.intp]) -> NDArray[Any]:
        x, y = self.plan.x, self.plan.y
        make = np.empty if len(phases) == self.grid.phases else np.zeros
        return make((x.count * x.valid, y.count * y.valid, self.grid.phases), self.dtype)

    def _image(self, cells: NDArray[Any]) -> NDArray[Any]:
        """Return the image of cells ``(Lx, Ly, phases)``."""
        (ny, nx), (cy, cx) = self.grid.period, self.grid.cells
        whole = cells[:cx, :cy].reshape(cx, cy, ny, nx).transpose(1, 2, 0, 3).reshape(cy * ny, cx * nx)
        return np.ascontiguousarray(self.grid.unpack(whole))


def _step(rows: int, phases: int) -> int:
    """Return how many rows of the lattice are transformed together, for any worker."""
    return max(-(-rows // PARTS), -(-COLUMNS // phases))


def _inside(start: int, length: int, limit: int) -> slice:
    """Return the part of ``range(length)`` that, moved by ``start``, falls into ``range(limit)``."""
    return slice(max(0, -start), max(max(0, -start), min(length, limit - start)))
