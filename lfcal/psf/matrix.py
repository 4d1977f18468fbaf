"""The 5-D PSF matrix H and its transposed view."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfcal.base import InputError, check_psf_shape
from lfcal.psf._indexing import in_range, resolved
from lfcal.psf._planes import ArrayPlanes, DatasetPlanes, FilePlanes, Planes, ScaledPlanes, as_planes, as_stored
from lfcal.psf._travel import reduced
from lfcal.psf.facts import Facts, Origin, fitting, unpack_valid

if TYPE_CHECKING:
    import xarray

    from lfcal.camera import Camera
    from lfcal.psf.aperture import Aperture

__all__ = ["PSFMatrix"]


class PSFMatrix:
    """The PSF matrix ``H[z, y, x, t, s]`` in an array, a memory map or an H file.

    The axes are the depth plane z, the source position (y, x) within the period, and the pixel (t, s) of the cutout.
    Both y and t are rows. Slicing follows numpy's rules of basic indexing (integers, slices, ellipsis) and reads only
    the required values. ``H.T`` is the transposed matrix as a view: each slice is computed from H on demand, and
    ``H.T.T`` is H. Returned arrays must not be modified, because they may be views of the stored values.

    Parameters
    ----------
    data
        Values ``(nz, ny, nx, nt, ns)``: an array, a memory map, an HDF5 dataset, or planes of a file.
    depths
        Object depth of each plane (µm, relative to the working plane, positive away from the camera). None: unknown.
    camera
        Camera to which H belongs, which requires ``depths``. None: unknown.
    anchor
        Sensor position ``(row, column)`` of the image of the source position (0, 0) (px).
    scale, offset
        Conversion of stored numbers to values, ``value = stored * scale + offset``; each is one number, or an array
        ``(nz,)``.
    recorded
        Number of frames recorded at each position, ``(nz, ny, nx)``, 0 if it is missing. None: one at every position.
    saturated
        Number of saturated pixels in the pattern of each position, ``(nz, ny, nx)``, -1 if unknown. None: not counted.
    facts
        All facts about the positions, in place of ``recorded`` and ``saturated``.
    uncertainty
        Standard deviation of every entry, in the shape of ``data``, 0 where only `Facts.noise` is known. None: not
        stated.
    depth_sums
        Sums of each plane over all source positions, ``(nz, nt, ns)``, if they are already known.
    region
        Name of the region of the field of view; empty if there is only one.
    transposed
        Whether ``data`` contains the transposed matrix HT.
    provenance
        Provenance of H: how it was measured or computed, as plain JSON types.

    Raises
    ------
    InputError
        If ``data`` does not have five axes, a side of its cutout is even, or another argument does not match its shape.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> PSFMatrix(np.arange(9.0).reshape(1, 1, 1, 3, 3)).T[0, 0, 0].tolist()  # a period of 1 x 1: H turned by 180°
    [[8.0, 7.0, 6.0], [5.0, 4.0, 3.0], [2.0, 1.0, 0.0]]
    """

    def __init__(
        self,
        data: Any,
        *,
        depths: ArrayLike | None = None,
        camera: Camera | None = None,
        anchor: tuple[float, float] = (0.0, 0.0),
        scale: ArrayLike = 1.0,
        offset: ArrayLike = 0.0,
        recorded: ArrayLike | None = None,
        saturated: ArrayLike | None = None,
        facts: Facts | None = None,
        uncertainty: Any = None,
        depth_sums: ArrayLike | None = None,
        region: str = "",
        transposed: bool = False,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        planes = _as_planes(data)
        shape = check_psf_shape(planes.shape)
        per_plane = (shape[0],)
        # one number, or one per plane, becomes one per plane
        scales = np.broadcast_to(np.asarray(scale, np.float64), per_plane)
        offsets = np.broadcast_to(np.asarray(offset, np.float64), per_plane)
        if (scales != 1).any() or (offsets != 0).any():
            planes = ScaledPlanes(planes, scales, offsets)
        self._planes: Planes = planes
        self._shape = shape
        self._depths = fitting("depths", np.full(shape[0], np.nan) if depths is None else depths, per_plane, np.float64)
        if np.isnan(self._depths).any() and not np.isnan(self._depths).all():
            raise InputError.expected(
                "depths", "one for each plane, or none", self._depths.tolist(), "give the missing depths"
            )
        if camera is not None and not self.knows_depths:
            raise InputError.expected(
                "depths of the planes of H with a camera",
                f"{shape[0]} depths in µm",
                "none",
                "give the depths together with the camera",
            )
        self._camera = camera
        self._anchor = (float(anchor[0]), float(anchor[1]))
        given = {"recorded": recorded, "saturated": saturated} if facts is None else facts.known()
        self._facts = Facts.of(shape[:3], shape[3:], **given)
        self._uncertainty = None if uncertainty is None else _as_planes(uncertainty)
        if self._uncertainty is not None and self._uncertainty.shape != shape:
            raise InputError.expected(
                "uncertainty", f"shape {shape}", self._uncertainty.shape, "give one value for each entry of H"
            )
        self.region = region
        self._provenance = dict(provenance or {})
        self._sums: dict[int, NDArray[np.float64]] = {}
        if depth_sums is not None:
            self._sums = dict(enumerate(fitting("depth sums", depth_sums, (shape[0], *shape[3:]), np.float64)))
        self._apertures: dict[int, Aperture] = {}
        self._lock = threading.Lock()
        self._other: PSFMatrix | None = None
        self._is_transposed = transposed
        self._opened: Callable[[], PSFMatrix] | None = None

    def opened_by(self, again: Callable[[], PSFMatrix]) -> PSFMatrix:
        """Register a function that reopens the matrix from its file, for use by other processes; return the matrix."""
        self._opened = again
        return self

    def __reduce__(self) -> Any:
        """Return the pickle state: the path to open again, or the values of an array in memory.

        Raises
        ------
        InputError
            For a dataset or memory map that the caller opened, because its file cannot be opened again.
        """
        values = [one for one in (self._planes, self._uncertainty) if one is not None]
        return reduced(type(self), self.__dict__, values, self._opened, self._is_transposed)

    # -- description -----------------------------------------------------------------------------------
    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape ``(nz, ny, nx, nt, ns)``: planes, source positions, pixels of the cutout."""
        return self._shape

    @property
    def ndim(self) -> int:
        """Number of axes: 5."""
        return 5

    @property
    def size(self) -> int:
        """Number of entries."""
        return int(np.prod(self._shape, dtype=np.int64))

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of the values as they are read, which may differ from the stored type."""
        return self._planes.dtype

    @property
    def nbytes(self) -> int:
        """Size of the complete matrix if it is read into memory (bytes)."""
        return self.size * self.dtype.itemsize

    @property
    def period(self) -> tuple[int, int]:
        """Number of source positions ``(ny, nx)`` in one period; successive positions are one pixel of H apart."""
        return self._shape[1], self._shape[2]

    @property
    def cutout(self) -> tuple[int, int]:
        """Number of rows and columns ``(nt, ns)`` of a pattern (px)."""
        return self._shape[3], self._shape[4]

    @property
    def depths(self) -> NDArray[np.float64]:
        """Object depth of each plane, ``(nz,)`` (µm from the working plane, positive away from the camera).

        If the depths are unknown, these are the plane numbers, from 0.
        """
        return self._depths if self.knows_depths else np.arange(self._shape[0], dtype=np.float64)

    @property
    def known_depths(self) -> NDArray[np.float64]:
        """Object depths as in `depths`, ``(nz,)`` (µm), but NaN for every plane if they are unknown."""
        return self._depths

    @property
    def knows_depths(self) -> bool:
        """Whether H states the depths of its planes."""
        return not bool(np.isnan(self._depths).any())

    @property
    def camera(self) -> Camera | None:
        """The camera to which H belongs; None if unknown."""
        return self._camera

    @property
    def pixel_scale(self) -> tuple[float, float]:
        """Pixels of H per sensor pixel along (rows, columns).

        They differ from 1 if frames were resampled such that the lenslet period is a whole number of pixels.
        """
        cutout = self._provenance.get("cutout")
        scale = cutout.get("scale", (1.0, 1.0)) if isinstance(cutout, Mapping) else (1.0, 1.0)
        # provenance comes from a file that anyone may have written
        known = isinstance(scale, list | tuple) and len(scale) == 2 and all(isinstance(v, int | float) for v in scale)
        return (float(scale[0]), float(scale[1])) if known and min(scale) > 0 else (1.0, 1.0)

    @property
    def anchor(self) -> tuple[float, float]:
        """Sensor position (row, column) of the image of the source position (0, 0) of H (px)."""
        return self._anchor

    @property
    def facts(self) -> Facts:
        """Measurement facts about the source positions of H; not available for HT.

        Raises
        ------
        InputError
            If this matrix is HT.
        """
        if self._is_transposed:
            raise InputError.expected(
                "metadata of the positions", "H", "HT, whose positions are pixels of H", "use HT.T.facts"
            )
        return self._facts

    @property
    def recorded(self) -> NDArray[np.uint16]:
        """Number of frames recorded at each position, ``(nz, ny, nx)``; 1 everywhere if unknown. Only for H, not HT."""
        known = self.facts.recorded
        return np.ones(self._shape[:3], np.uint16) if known is None else known

    @property
    def saturated(self) -> NDArray[np.int32] | None:
        """Number of saturated pixels in each pattern, ``(nz, ny, nx)``; -1 or None: unknown. Only for H, not HT."""
        return self.facts.saturated

    @property
    def missing(self) -> NDArray[np.intp]:
        """Indices (z, y, x) of the positions that were never recorded, ``(n, 3)``. Only for H, not HT."""
        return np.argwhere(self.recorded == 0)

    def valid(self, z: int, y: int, x: int) -> NDArray[np.bool_]:
        """Return a mask ``(nt, ns)`` of the pattern at (z, y, x): False for pixels known to have no measurement.

        Only for H, not HT.
        """
        packed = self.facts.valid
        if packed is None:
            return np.ones(self.cutout, np.bool_)
        return unpack_valid(packed[z, y, x], self.cutout)

    def variance(self, z: int, y: int, x: int) -> NDArray[np.float64] | None:
        """Return the noise variance ``(nt, ns)`` of the pattern at (z, y, x) in squared units of H; None if unknown.

        Only for H, not HT.
        """
        noise = self.facts.noise
        if noise is None or not np.isfinite(noise[z, y, x]).all():
            return None
        constant, slope = noise[z, y, x].astype(np.float64)
        # the variance grows with the signal; noise may make a sample negative, but the photon part never is
        variance: NDArray[np.float64] = constant + slope * np.maximum(self[z, y, x].astype(np.float64), 0)
        return variance

    def uncertainty(self, z: int, y: int, x: int) -> NDArray[np.float32] | None:
        """Return the standard deviation ``(nt, ns)`` of the pattern at (z, y, x), in the unit of H; None if unknown.

        Where `Facts.origin` is `Origin.MEASURED`, and if H states no uncertainty, it is the square root of `variance`.
        Elsewhere, it is the stated uncertainty of H (`stated_uncertainty`). If `Facts.origin` is None, the stated
        uncertainty is used everywhere. Only for H, not HT.
        """
        stated = self._uncertainty
        if stated is not None:
            found: NDArray[np.float32] = stated.cutout(z, y, x)
            if self.facts.origin is None or self.facts.origin[z, y, x] != Origin.MEASURED:
                return found
        variance = self.variance(z, y, x)
        return None if variance is None else np.sqrt(variance).astype(np.float32)

    @property
    def stated_uncertainty(self) -> Planes | None:
        """Source of the stated standard deviations of all entries of H; None if H states none.

        The values are 0 where only `Facts.noise` is known. For HT, they are those of H.
        """
        return self._uncertainty

    @property
    def provenance(self) -> dict[str, Any]:
        """Provenance of H, as plain JSON types."""
        return dict(self._provenance)

    @property
    def path(self) -> str:
        """Path of the file from which the values are read (also for the view ``H.T``); empty for a numpy array."""
        stored = self._stored()
        return str(stored.path) if isinstance(stored, DatasetPlanes | FilePlanes) else ""

    def _stored(self) -> Planes:
        """Return the planes as they are stored, before scales, transposes and the order of another code are applied."""
        return as_stored(self._planes)

    @property
    def is_transposed(self) -> bool:
        """Whether this matrix is HT: the view ``H.T``, or a matrix stored as HT."""
        return self._is_transposed

    # -- values ----------------------------------------------------------------------------------------
    @property
    def planes(self) -> Planes:
        """Source of the values, which returns single depth planes or patterns."""
        return self._planes

    @property
    def T(self) -> PSFMatrix:
        """The transposed matrix as a view, whose values are computed on demand; ``H.T.T`` is H."""
        with self._lock:
            if self._other is None:
                other = PSFMatrix.__new__(PSFMatrix)
                # the transpose shares data and facts, but has separate sums, fits and locks
                other.__dict__.update(self.__dict__)
                other._planes = self._planes.transposed()
                # HT = H^T rotates each pattern, so its depth-plane sums are those of H rotated by 180 degrees; no
                # plane is read
                other._sums = {z: s[::-1, ::-1] for z, s in self._sums.items()}
                other._apertures = {}
                other._lock = threading.Lock()
                other._is_transposed = not self._is_transposed
                # both refer to each other, so that H.T.T is H itself and a kept plane is stored only once
                other._other = self
                self._other = other
            return self._other

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z``, shape ``(ny, nx, nt, ns)``, read-only; it may be a view of the stored values."""
        return _read_only(self._planes.plane(in_range(z, 0, self._shape[0])))

    def depth_sum(self, z: int) -> NDArray[np.float64]:
        """Return the sum ``(nt, ns)`` of plane ``z`` over all source positions, an image of the camera's aperture.

        The returned array is read-only and is computed only once. The sum of HT is that of H rotated by 180°.
        """
        z = in_range(z, 0, self._shape[0])
        if z not in self._sums:
            if self._other is not None and z in self._other._sums:
                self._sums[z] = self._other._sums[z][::-1, ::-1]
            else:
                from lfcal.psf._transpose import depth_sum

                self._sums[z] = depth_sum(self.plane(z))
        return _read_only(self._sums[z])

    def aperture(self, z: int) -> Aperture:
        """Return the camera's iris as fitted to the `depth_sum` of plane ``z``; see `lfcal.psf.aperture`."""
        z = in_range(z, 0, self._shape[0])
        if z not in self._apertures:
            from lfcal.psf.aperture import fit_aperture, footprint_px

            width = footprint_px(self.camera, self.pixel_scale)
            self._apertures[z] = fit_aperture(self.depth_sum(z), footprint_px=width)
        return self._apertures[z]

    def __len__(self) -> int:
        """Return the number of depth planes."""
        return self._shape[0]

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Yield the planes, each ``(ny, nx, nt, ns)`` and read-only."""
        return map(self.plane, range(self._shape[0]))

    def __getitem__(self, key: Any) -> Any:
        """Return the selected values, by numpy's rules for integers, slices and ellipsis."""
        index = resolved(key, self._shape)
        z, y, x = index[:3]
        if isinstance(z, int):
            return self._from_plane(z, y, x, index[3:])
        planes = [self._from_plane(k, y, x, index[3:]) for k in range(*z.indices(self._shape[0]))]
        if planes:
            return np.stack(planes)
        # an empty selection still has numpy's shape and type
        dummy = np.empty((0, *self._shape[1:]), self.dtype)
        return dummy[(slice(None), *index[1:])]

    def _from_plane(self, z: int, y: int | slice, x: int | slice, pixels: tuple[int | slice, ...]) -> Any:
        if isinstance(y, int) and isinstance(x, int):
            return _read_only(self._planes.cutout(z, y, x))[pixels]
        rows = [y] if isinstance(y, int) else list(range(*y.indices(self._shape[1])))
        columns = [x] if isinstance(x, int) else list(range(*x.indices(self._shape[2])))
        # to read more than a quarter of a plane, one pass over its chunks is faster than single chunks
        if len(rows) * len(columns) * 4 > self._shape[1] * self._shape[2]:
            return _read_only(self._planes.plane(z))[(y, x, *pixels)]
        block = np.empty((len(rows), len(columns), *self._shape[3:]), self.dtype)
        for a, row in enumerate(rows):
            for b, column in enumerate(columns):
                block[a, b] = self._planes.cutout(z, row, column)
        pick = (0 if isinstance(y, int) else slice(None), 0 if isinstance(x, int) else slice(None))
        return block[(*pick, *pixels)]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the complete matrix as an array in memory."""
        if isinstance(self._planes, ArrayPlanes):
            array = self._planes.array
            return np.array(array, dtype, copy=True) if copy else np.asarray(array, dtype)
        if copy is False:
            raise ValueError(
                "a PSF matrix that is read from a file, scaled or transposed cannot become an array without a copy"
            )
        out = np.empty(self._shape, self.dtype if dtype is None else dtype)
        for z in range(self._shape[0]):
            out[z] = self._planes.plane(z)
        return out

    def to_xarray(self) -> xarray.DataArray:
        """Return H as an `xarray.DataArray` that reads from the file only the values that are used.

        Its dimensions are z, y, x, t and s. The coordinate z contains the `depths`; y and x are the indices of
        source positions from 0; t and s are pixels from the centre of the cutout.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        from lfcal.psf._xarray import labelled

        depths = {"long_name": "depth", "units": "um"} if self.knows_depths else {"long_name": "plane"}
        axes: dict[str, tuple[NDArray[Any], dict[str, str]]] = {"z": (self.depths, depths)}
        for axis, n in zip("yx", self.period, strict=True):
            axes[axis] = (np.arange(n), {"long_name": "source position"})
        for axis, n in zip("ts", self.cutout, strict=True):
            axes[axis] = (np.arange(n) - (n - 1) // 2, {"long_name": "pixel of the cutout", "units": "px"})
        camera = {} if self._camera is None else {"camera": self._camera.name}
        facts = {"anchor": self._anchor, "region": self.region, **camera}
        name = "HT" if self._is_transposed else "H"
        return labelled(self.__getitem__, self.dtype, axes, name=name, attrs=facts)

    def close(self) -> None:
        """Close the HDF5 file of the matrix, if there is one; the values can then no longer be read."""
        stored = self._stored()
        if isinstance(stored, DatasetPlanes):
            stored.close()

    def __enter__(self) -> PSFMatrix:
        """Return H; its file is closed at the end of the context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file of H."""
        self.close()

    def __repr__(self) -> str:
        """Return a line with shape, type and camera."""
        name = "PSFMatrix.T" if self._is_transposed else "PSFMatrix"
        camera = f", camera {self._camera.name!r}" if self._camera is not None else ""
        return f"<{name} (z, y, x, t, s) = {self._shape}, {self.dtype}{camera}>"


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view, which protects kept planes and the user's arrays."""
    view = values.view()
    view.flags.writeable = False
    return view


def _as_planes(data: Any) -> Planes:
    return data._planes if isinstance(data, PSFMatrix) else as_planes(data)
