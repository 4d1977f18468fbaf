"""Projector pair: from volume to image, and back."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained, for_each_chunk, free_memory, worker_count
from lfcal.psf import PSFMatrix, mean_noise
from lfcal.reconstruct.projectors._device_forecast import engine_on, forecast_on
from lfcal.reconstruct.projectors._direct import Direct
from lfcal.reconstruct.projectors._engine import Engine
from lfcal.reconstruct.projectors._planes import PlaneReader
from lfcal.reconstruct.projectors._polyphase import Polyphase
from lfcal.reconstruct.projectors._position_fft import position_fft
from lfcal.reconstruct.projectors._recipe import Tiles, read_recipe, recipe_of
from lfcal.reconstruct.projectors._reduced import Reduced
from lfcal.reconstruct.projectors._reduction import SPACINGS
from lfcal.reconstruct.projectors._sparse import Sparse
from lfcal.reconstruct.projectors.device import ArrayDevice
from lfcal.reconstruct.projectors.forecast import (
    REDUCED,
    ProjectionForecast,
    ProjectionProblem,
    reading_seconds,
)
from lfcal.reconstruct.projectors.grid import Grid, anchor_pixel

__all__ = ["Projector"]

LARGE = 1 << 22
"""Number of values above which threads check them faster."""

SMALL_S = 3e-3
"""Time per plane and pair below which a projection uses one thread (s)."""


class Projector:
    """Linear operator of a periodic PSF matrix H, and its exact adjoint; there is no light from outside the volume.

    `forward` computes the image ``f[p] = sum_z sum_v g[z, v] H[z, (v - anchor) mod n][p - v + c]`` of a volume g.
    `adjoint` computes the back projection ``b[z, v] = sum_p f[p] H[z, (v - anchor) mod n][p - v + c]`` (Eberhart et al.
    2020, equation 1, H and HT). Pixels p and voxels v are (row, column), n is the period, and c the middle of the
    cutout.

    Parameters
    ----------
    H
        `PSFMatrix`, or an array, memory map or dataset ``(nz, ny, nx, nt, ns)``, with any period and a cutout of odd
        size. Planes are read one at a time.
    image_shape
        Shape ``(Y, X)`` of the image and of each plane of the volume (px); it need not be a multiple of the period.
    anchor
        Pixel (row, column) onto which the source at position (0, 0) is imaged, rounded down to integers. None: that of
        ``H`` if it is a `PSFMatrix`, else (0, 0).
    method
        ``"polyphase"``, ``"direct"``, ``"sparse"``, ``"reduced"`` (with a ``tolerance``), ``"fft"`` (the reference
        method, position by position), or ``"auto"``, the fastest method according to `forecast`. You may also pass the
        `recipe` of another projector, such as ``"polyphase:7x3"`` (tiles down and across). Projections are then
        identical to those of that projector for any number of workers.
    dtype
        Type of images and volumes, float32 or float64.
    threshold
        Fraction of a plane's peak below which entries of H are treated as zero.
    tolerance
        Largest fraction of the light that projections may omit, in [0, 1). An operator Hs is applied instead of H. For
        any non-negative volume g, |(H - Hs) g|_1 is at most ``tolerance`` times the sum of g_v |H_v|_1 over all voxels
        v. An H that changes slowly between positions is then projected several times faster. 0: exact projections.
    memory_limit
        Largest amount of memory that a projection may use (bytes). None: half of the free memory.
    workers
        Number of threads. None: all processors.
    phases
        Mask ``(ny, nx)``, True at the image phases in use; other pixels are zero in images, and ignored in back
        projections. None: all.
    device
        ``"cpu"``; ``"cuda"`` or ``"cuda:1"``, an accelerator that PyTorch or CuPy can use; ``"auto"``, an accelerator
        if there is one and the problem fits into its memory; or an `ArrayDevice`. Volumes and images remain numpy
        arrays.

    Raises
    ------
    InputError
        If an argument is invalid, H is not finite, or no method fits into the memory.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import open_psf
    >>> from lfcal.reconstruct import Projector
    >>> with open_psf("H.h5") as H:
    ...     P = Projector(H, (80, 96), method="direct")
    ...     volume = np.zeros(P.volume_shape)
    ...     volume[1, 40, 48] = 2.0
    ...     image = P.forward(volume)
    ...     print(P)
    ...     print(f"light over that of one pattern: {image.sum() / H[1, (40 - 30) % 19, (48 - 32) % 33].sum():.3f}")
    <Projector (2, 80, 96) -> (80, 96), period (19, 33), direct>
    light over that of one pattern: 2.000
    """

    def __init__(
        self,
        H: Any,
        image_shape: tuple[int, int],
        anchor: tuple[float, float] | None = None,
        method: str = "auto",
        *,
        dtype: DTypeLike = np.float32,
        threshold: float = 0.0,
        tolerance: float = 0.0,
        memory_limit: int | None = None,
        workers: int | None = None,
        phases: ArrayLike | None = None,
        device: str | ArrayDevice = "cpu",
    ) -> None:
        check_number("tolerance of the projection", tolerance, at_least=0, below=1)
        method, tiles = read_recipe(method)
        if method == REDUCED and tolerance == 0:
            what = f"projection method {REDUCED}"
            raise InputError.expected(what, "a tolerance above 0", 0, "give a positive tolerance; 0.005 is usual")
        self._tolerance = float(tolerance)
        data = H if hasattr(H, "shape") else np.asarray(H)
        self._reader = PlaneReader(data, np.dtype(dtype), threshold)
        _, ny, nx, nt, ns = self._reader.shape
        own = H.anchor if isinstance(H, PSFMatrix) else (0, 0)
        at = own if anchor is None else anchor
        shape = (int(image_shape[0]), int(image_shape[1]))
        self._grid = Grid(shape, (ny, nx), (nt, ns), anchor_pixel(at))
        self._phases = None if phases is None else _phase_mask(phases, (ny, nx))
        self._workers = worker_count(workers)
        self._limit = free_memory() // 2 if memory_limit is None else int(memory_limit)
        self._device, self._forecast = forecast_on(device, self._problem(method, tiles), method, self._limit)
        self._engine = self._build()
        self._operands: dict[int, Any] = {}
        self._lock = threading.RLock()
        self._subsets: dict[bytes, Projector] = {}
        self._quiet: Projector | None = None

    # -- what it is ------------------------------------------------------------------------------------
    @property
    def image_shape(self) -> tuple[int, int]:
        """Shape ``(Y, X)`` of images (px)."""
        return self._grid.image_shape

    @property
    def volume_shape(self) -> tuple[int, int, int]:
        """Shape ``(nz, Y, X)`` of volumes (voxels)."""
        return self._reader.shape[0], *self._grid.image_shape

    @property
    def period(self) -> tuple[int, int]:
        """Period ``(ny, nx)`` of H (px)."""
        return self._grid.period

    @property
    def grid(self) -> Grid:
        """Mapping of the pixels of images to phases and periods."""
        return self._grid

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of computed images and volumes, float32 or float64."""
        return self._reader.dtype

    @property
    def method(self) -> str:
        """Name of the projection method in use, such as ``"polyphase"``."""
        return self._engine.name

    @property
    def recipe(self) -> str:
        """Method and tiles, such as ``"polyphase:7x3"``; a projector with this ``method`` computes identical values."""
        return recipe_of(self.method, self._forecast.plan, self._forecast.band)

    @property
    def device(self) -> ArrayDevice | None:
        """Accelerator that computes projections; None for the CPU."""
        return self._device

    @property
    def memory_limit(self) -> int:
        """Largest amount of memory that a projection may use (bytes)."""
        return self._limit

    @property
    def rounding(self) -> float:
        """Rounding error of projected values as a fraction of the largest value; do not divide by smaller values."""
        return self._engine.rounding

    @property
    def tolerance(self) -> float:
        """Largest fraction of the light that projections may omit, as requested; 0: projections are exact."""
        return self._tolerance

    def operand_bytes(self) -> int:
        """Return the size of the prepared planes of H in memory (bytes)."""
        return sum(self._engine.operand_bytes(operand) for operand in self._operands.values())

    @property
    def camera(self) -> Any:
        """Camera of H; None if unknown."""
        return self._reader.H.camera if isinstance(self._reader.H, PSFMatrix) else None

    @property
    def depths(self) -> NDArray[np.float64]:
        """Depth of each plane (µm), ``(nz,)``; the plane indices if H has no depths."""
        known = self.known_depths
        return np.arange(self.volume_shape[0], dtype=float) if known is None else known

    @property
    def known_depths(self) -> NDArray[np.float64] | None:
        """Depth of each plane (µm), ``(nz,)``; None if H is not a `PSFMatrix`, or states no depths."""
        H = self._reader.H
        return np.asarray(H.depths, float) if isinstance(H, PSFMatrix) and H.knows_depths else None

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """Mean noise of each plane of H, ``(nz, 2)``: variance at zero signal, and its increase per unit of signal.

        0 for planes whose noise is unknown; None if it is unknown for all.
        """
        return mean_noise(self._reader.H)

    def denoised(self) -> Projector:
        """Return a projector of H with reduced noise (`lfcal.psf.denoising`), or this one if the noise is unknown."""
        if self._reader.denoise or self.noise is None:
            return self
        with self._lock:
            if self._quiet is None:
                self._quiet = self._reading(denoise=True)
            return self._quiet

    def with_new_noise(self, seed: int) -> Projector:
        """Return a projector of H with additional random noise, of the same variance as the noise of recorded patterns.

        ``seed`` is the seed of the noise. The noise is reduced, like that of H, if this is a `denoised` projector. If
        the noise of H is unknown, this projector is returned.
        """
        return self if self.noise is None else self._reading(noise_seed=seed)

    def part(self, rows: slice, columns: slice) -> Projector:
        """Return a projector for a part of images and volumes; both slices must have a start and a stop."""
        (row, column), shape = self._grid.anchor, (rows.stop - rows.start, columns.stop - columns.start)
        made = Projector(
            self._reader.H,
            shape,
            (row - rows.start, column - columns.start),
            dtype=self.dtype,
            threshold=self._reader.threshold,
            tolerance=self._tolerance,
            memory_limit=self._limit,
            workers=self._workers,
            device="cpu" if self._device is None else self._device,
        )
        return _remade(lambda: made, self._reader.changes)

    def _reading(self, **changes: Any) -> Self:
        """Return a projector that reads the planes of H with other settings of `PlaneReader`."""
        part = object.__new__(type(self))
        part.__dict__.update(self.__dict__)
        part._reader = replace(self._reader, **changes)
        part._operands, part._subsets, part._lock = {}, {}, threading.RLock()
        return part

    def forecast(self) -> ProjectionForecast:
        """Return the predicted time and memory on this computer of the method in use and of the others examined."""
        return self._forecast

    # -- the pair --------------------------------------------------------------------------------------
    def forward(self, volume: ArrayLike) -> NDArray[Any]:
        """Return the image ``(Y, X)`` of ``volume`` ``(nz, Y, X)``, as a new array; planes of zeros are skipped."""
        data = self._checked(volume, "volume (z, y, x)", self.volume_shape)
        return self.forward_planes(enumerate(data))

    def forward_planes(self, planes: Iterable[tuple[int, NDArray[Any]]]) -> NDArray[Any]:
        """Return the image ``(Y, X)`` of a volume given plane by plane, with one plane in memory at a time.

        ``planes`` yields pairs of a plane index and a plane ``(Y, X)``; planes that are missing are zero.
        """
        return self._engine.forward((self._operand(z), plane) for z, plane in planes if plane.any())

    def adjoint(self, image: ArrayLike) -> NDArray[Any]:
        """Return the back projection ``(nz, Y, X)`` of ``image`` ``(Y, X)``, as a new array."""
        data = self._checked(image, "image (y, x)", self.image_shape)
        out = np.empty(self.volume_shape, self.dtype)
        for z, plane in enumerate(self.adjoint_planes(data)):
            out[z] = plane
        return out

    def adjoint_planes(self, image: NDArray[Any]) -> Iterator[NDArray[Any]]:
        """Yield the planes ``(Y, X)`` of the back projection of ``image``; each is valid until the next one is made."""
        return self._engine.adjoint(image, self._each_operand())

    def subset(self, phases: ArrayLike) -> Projector:
        """Return a projector that uses only the image phases at which the mask ``phases`` ``(ny, nx)`` is True.

        The mask is as in `Projector`. The returned projector uses the same method, and is created only once for each
        mask. If the prepared planes do not depend on the phases, it shares them with this projector.
        """
        mask = _phase_mask(phases, self.period)
        with self._lock:
            if mask.tobytes() not in self._subsets:
                self._subsets[mask.tobytes()] = self._subset(mask)
            return self._subsets[mask.tobytes()]

    def _subset(self, phases: NDArray[np.bool_]) -> Projector:
        # use the same tiles, so that all subsets together need no more memory than this projector
        part = object.__new__(Projector)
        part.__dict__.update(self.__dict__)
        part._phases = phases
        part._engine = part._build()
        part._subsets, part._quiet = {}, None
        if not (self._engine.any_phases and self._forecast.chosen.resident):
            part._operands, part._lock = {}, threading.RLock()
        return part

    def __reduce__(self) -> Any:
        """Pickle the projector as its arguments: H and the settings."""
        settings: dict[str, Any] = {
            "dtype": self.dtype,
            "threshold": self._reader.threshold,
            "tolerance": self._tolerance,
            "memory_limit": self._limit,
            "workers": self._workers,
            "phases": self._phases,
            "device": "cpu" if self._device is None else self._device,
        }
        made = partial(Projector, self._reader.H, self.image_shape, self._grid.anchor, self.recipe, **settings)
        return _remade, (made, self._reader.changes)

    def iter_prepare(self) -> Work[Projector]:
        """Prepare the planes of H before the first projection, if all fit into memory; return this projector."""
        yield from self._iter_planes()
        return self

    prepare = drained(iter_prepare)

    def _iter_planes(self) -> Work[None]:
        clock = Clock("preparing planes of H", self.volume_shape[0])
        for z in range(self.volume_shape[0]):
            if self._forecast.chosen.resident:
                self._operand(z)
            yield clock.at(z + 1)

    # -- inside ----------------------------------------------------------------------------------------
    def _problem(self, method: str, tiles: Tiles | None = None) -> ProjectionProblem:
        pixels = self._grid.phases if self._phases is None else int(self._phases.sum())
        density = self._reader.density() if method in ("auto", "sparse") else 1.0
        nz = self._reader.shape[0]
        kept = self._reader.reduced(self._tolerance, SPACINGS) if self._tolerance > 0 else {}
        read_s = reading_seconds(self._reader)
        noisy = self.noise is not None
        return ProjectionProblem(self._grid, nz, pixels, self.dtype, self._workers, density, read_s, kept, tiles, noisy)

    def _build(self) -> Engine:
        chosen = self._forecast
        if self._device is not None:
            common = (self.dtype, self._workers, self._phases)
            return engine_on(self._device, chosen, self._grid, common, self._tolerance)
        small = chosen.chosen.pair_s < SMALL_S * self.volume_shape[0]
        args = (self.dtype, 1 if small else self._workers, self._phases)
        if chosen.plan is not None:
            return Polyphase(self._grid, chosen.plan, *args, band=chosen.band)
        if chosen.chosen.method == REDUCED:
            return Reduced(self._grid, *args, tolerance=self._tolerance)
        kinds: dict[str, Callable[..., Engine]] = {"direct": Direct, "sparse": Sparse, "fft": position_fft}
        return kinds[chosen.chosen.method](self._grid, *args)

    def _operand(self, z: int) -> Any:
        with self._lock:
            if z in self._operands:
                return self._operands[z]
            operand = self._engine.prepare(self._reader.read(z))
            if self._forecast.chosen.resident:
                self._operands[z] = operand
            return operand

    def _each_operand(self) -> Iterator[Any]:
        yield from (self._operand(z) for z in range(self.volume_shape[0]))

    def _checked(self, array: ArrayLike, what: str, shape: tuple[int, ...]) -> NDArray[Any]:
        data = np.asarray(array, self.dtype)
        if data.shape != shape:
            raise InputError.expected(
                what, f"shape {shape}", data.shape, "crop or pad it to the shape of the projector"
            )
        workers = self._workers if data.size >= LARGE else 1
        if not all(for_each_chunk(lambda a, b: bool(np.isfinite(data[a:b]).all()), len(data), workers)):
            raise InputError.expected(
                what, "finite values", "NaN or infinity", "give these pixels weight 0 in the solver"
            )
        return data

    def __repr__(self) -> str:
        """Return size and method as a one-line text."""
        return f"<Projector {self.volume_shape} -> {self.image_shape}, period {self.period}, {self.method}>"


def _remade(make: Callable[[], Projector], changes: dict[str, Any]) -> Projector:
    """Return the projector that ``make`` creates, reading H with ``changes`` of `PlaneReader`."""
    return make()._reading(**changes) if changes else make()


def _phase_mask(phases: ArrayLike, period: tuple[int, int]) -> NDArray[np.bool_]:
    mask = np.array(phases, np.bool_)
    if mask.shape != period or not mask.any():
        raise InputError.expected(
            "image phases", f"a mask of shape {period} with at least one phase", mask.shape, "correct the mask"
        )
    return mask
