"""Resample light fields so that the lenslet period becomes a whole number of pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, for_each_chunk, note, warn
from lfcal.records import LightFieldSettings

if TYPE_CHECKING:
    from lfcal.camera import Camera
    from lfcal.lattice import LatticeFit

__all__ = [
    "MOST_DRIFT",
    "Resampling",
    "drift_note",
    "drift_words",
    "lattice_anchor_of",
    "resampling_for",
    "resampling_of",
]

Pair = tuple[float, float]

MOST_DRIFT = 0.5
"""Drift of a frame's lattice relative to H's period below which frames are used unchanged (pixels)."""


@dataclass(frozen=True)
class Resampling:
    """Map from a frame to an image in which the lenslet period is a whole number of pixels along both axes.

    Points are (row, column) in px; integers are pixel centres.

    Attributes
    ----------
    origin
        Centre (row, column) of a micro-image in the frame (px).
    down, across
        Vectors (row, column) of one period down and one to the right in the frame (px).
    period
        Period ``(ny, nx)`` in the result (px).
    shape
        Shape ``(rows, columns)`` of the result (px).
    centre
        Position (row, column) of ``origin`` in the result (px).
    distortion
        `LatticeDistortion` of the lattice in the frame, for points (column, row) in px. The map removes it, and
        ``origin`` is the centre in the undistorted lattice. None: an affine map.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.reconstruct import Resampling
    >>> bench = preset("bench")  # hexagonal, 11 px: a period is 33 px wide and 11 sqrt(3) = 19.05 px high
    >>> whole = Resampling.of_camera(bench)
    >>> print(whole.period, [round(scale, 4) for scale in whole.scale], bench.sensor.shape, whole.shape)
    (19, 33) [0.9972, 1.0] (320, 320) (319, 319)
    >>> frame = np.ones(bench.sensor.shape)
    >>> print(f"{whole.apply(frame)[160, 160]:.4f}")  # a pixel covers more of the frame: 19.05 / 19
    1.0028
    """

    origin: Pair
    down: Pair
    across: Pair
    period: tuple[int, int]
    shape: tuple[int, int]
    centre: Pair
    distortion: Any = None

    def __post_init__(self) -> None:
        """Check that the map exists."""
        if min(self.period) < 1 or min(self.shape) < 1:
            got = f"the period {self.period} and the shape {self.shape}"
            remedy = "give the period in pixels, and the rows and columns"
            raise InputError.expected("period and shape", "positive values", got, remedy)
        _invertible(self.down, self.across, self.period)

    @classmethod
    def to_period(
        cls,
        shape: tuple[int, int],
        origin: Pair,
        down: Pair,
        across: Pair,
        period: tuple[int, int],
        lattice_anchor: Pair = (0.0, 0.0),
    ) -> Resampling:
        """Return the map from frames of ``shape`` to a whole-pixel period; it keeps as much of the frame as possible.

        Parameters
        ----------
        shape
            Rows and columns of the frame.
        origin, down, across
            Micro-image centre and period vectors (row, column) from a lattice fit (px), as in `Resampling`.
        period
            Period ``(ny, nx)`` of H (px).
        lattice_anchor
            Image (row, column) of H's source position (0, 0) relative to the nearest micro-image centre (px of the
            result), as in `ScanPlan.lattice_anchor`. `anchor` returns the pixel of the result at that position.
        """
        matrix = _invertible(down, across, period)
        # the corners of the frame also bound it in the result, because the map is affine
        corners = np.array([(r, c) for r in (0, shape[0] - 1) for c in (0, shape[1] - 1)], float)
        reached = (corners - np.array(origin)) @ np.linalg.inv(matrix).T
        low, high = reached.min(axis=0), reached.max(axis=0)
        # the first pixel of the result is a whole number of pixels from position (0, 0) of H.
        first = np.ceil(low - np.array(lattice_anchor) - 1e-9) + np.array(lattice_anchor)
        size = np.floor(high - first + 1e-9).astype(int) + 1
        return cls(origin, down, across, period, (int(size[0]), int(size[1])), (float(-first[0]), float(-first[1])))

    @classmethod
    def of_fit(
        cls, fit: Any, period: tuple[int, int] | None = None, lattice_anchor: Pair = (0.0, 0.0), types: int = 1
    ) -> Resampling:
        """Return the map for a measured lattice (`lfcal.lattice.LatticeFit`).

        Parameters
        ----------
        fit
            Object with the attributes ``kind``, ``shape``, ``origin_px`` (row, column) and ``distortion`` (None:
            straight rows), and a method ``basis_px()`` that returns the lattice vectors as rows (x, y) in px.
        period
            Period ``(ny, nx)`` of the result (px). None: the nearest whole numbers.
        lattice_anchor
            As in `to_period`.
        types
            Number of lens types: with three on a hexagonal array, the period is three lenslets wide.
        """
        bend, origin = fit.distortion, fit.origin_px
        if bend is not None:
            x, y = bend.invert(np.array(origin[::-1], float))
            origin = (float(y), float(x))
        made = cls._of_lattice(fit.kind, fit.basis_px(), origin, fit.shape, period, lattice_anchor, types=types)
        return replace(made, distortion=bend)

    @classmethod
    def of_camera(
        cls, camera: Any, period: tuple[int, int] | None = None, lattice_anchor: Pair = (0.0, 0.0)
    ) -> Resampling:
        """Return the map for the lattice of ``camera``; ``period`` and ``lattice_anchor`` are as in `of_fit`."""
        lattice, sensor = camera.lattice, camera.sensor
        x, y = lattice.offset_um
        origin = (sensor.centre_px[0] + y / sensor.pixel_um, sensor.centre_px[1] + x / sensor.pixel_um)
        basis = np.asarray(lattice.basis_um(), float) / sensor.pixel_um
        made = cls._of_lattice(
            lattice.kind, basis, origin, sensor.shape, period, lattice_anchor, types=len(lattice.types)
        )
        bend = lattice.distortion
        if bend is not None:
            bend = bend.scaled(1 / sensor.pixel_um, (sensor.centre_px[1], sensor.centre_px[0]))
        return replace(made, distortion=bend)

    @classmethod
    def _of_lattice(
        cls,
        kind: str,
        basis: ArrayLike,
        origin: Pair,
        shape: tuple[int, int],
        period: tuple[int, int] | None,
        lattice_anchor: Pair,
        *,
        types: int,
    ) -> Resampling:
        a, b = np.asarray(basis, float)
        across = a * (3 if kind == "hexagonal" and types == 3 else 1)
        # two rows down and half a lenslet back is straight down on a hexagonal lattice
        down = 2 * b - a if kind == "hexagonal" else b
        whole = (max(1, round(float(np.hypot(*down)))), max(1, round(float(np.hypot(*across)))))
        return cls.to_period(
            (int(shape[0]), int(shape[1])),
            (float(origin[0]), float(origin[1])),
            # basis vectors are (x, y), but points here are (row, column)
            (float(down[1]), float(down[0])),
            (float(across[1]), float(across[0])),
            period or whole,
            lattice_anchor,
        )

    @property
    def scale(self) -> Pair:
        """Scale of the map (down, across): px of the result per px of the frame."""
        ny, nx = self.period
        return ny / float(np.hypot(*self.down)), nx / float(np.hypot(*self.across))

    def anchor(self, lattice_anchor: Pair = (0.0, 0.0)) -> tuple[int, int]:
        """Return the pixel (row, column) of the result onto which position (0, 0) of H is imaged.

        ``lattice_anchor`` is that of H, as in `to_period`.
        """
        row, column = (c + a for c, a in zip(self.centre, lattice_anchor, strict=True))
        return round(row), round(column)

    def places(self, rows: NDArray[Any], columns: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return rows and columns in the frame (px) of the pixels ``rows`` and ``columns`` of the result.

        All four arrays have the same shape.
        """
        steps = np.stack([rows - self.centre[0], columns - self.centre[1]])
        matrix = self._matrix()
        place = np.tensordot(matrix, steps, axes=1) + np.array(self.origin).reshape(2, *([1] * (steps.ndim - 1)))
        if self.distortion is None:
            return place[0], place[1]
        seen = self.distortion.apply(np.stack([place[1], place[0]], axis=-1))
        return seen[..., 1], seen[..., 0]

    def pixel(self, place: Pair) -> Pair:
        """Return the pixel (row, column) of the result at a ``place`` (row, column) in the frame (px)."""
        row, column = place
        if self.distortion is not None:
            column, row = self.distortion.invert(np.array([column, row], float))
        at = np.linalg.solve(self._matrix(), np.array([row, column], float) - np.array(self.origin))
        return float(at[0]) + self.centre[0], float(at[1]) + self.centre[1]

    def drift(self, shape: tuple[int, int]) -> float:
        """Return the drift of the lattice over a frame of ``shape`` relative to the period of the result (px).

        The drift is the range (maximum minus minimum) of the displacement between frame and result along rows or along
        columns, whichever is larger.
        """
        # corners and edges are enough for an affine map; a distorted lattice may drift most anywhere
        rows, columns = np.meshgrid(*(np.linspace(0, n - 1, 9) for n in shape), indexing="ij")
        row, column = self.places(rows, columns)
        return float(max(np.ptp(row - rows), np.ptp(column - columns)))

    def apply(self, frame: ArrayLike, *, order: int = 3, workers: int | None = None) -> NDArray[np.float32]:
        """Return ``frame`` ``(rows, columns)`` resampled with splines of ``order`` (0 to 5), as float32.

        ``workers`` is the number of threads (None: all processors). Light is conserved: values are multiplied by the
        area of a pixel of the result in the frame. Pixels of the result outside the frame are 0. Pixels of the result
        are NaN if one of the four surrounding pixels of the frame is NaN or infinite.
        """
        from scipy.ndimage import distance_transform_edt, map_coordinates, spline_filter

        data = np.asarray(frame, np.float64)
        if data.ndim != 2:
            raise InputError.expected("frame", "two axes (rows, columns)", f"shape {data.shape}", "give one frame")
        lost = ~np.isfinite(data)
        if lost.all():
            return np.full(self.shape, np.nan, np.float32)
        if lost.any():  # splines would spread them over the whole frame
            nearest = distance_transform_edt(lost, return_distances=False, return_indices=True)
            data = data[tuple(nearest)]
        spline: Any = order
        # filter once for the whole frame, instead of in each thread's part
        prepared: Any = spline_filter(data, spline, mode="mirror") if order > 1 else data
        # pixels of the result cover a different area of the frame, so light per pixel scales with it
        area = abs(float(np.linalg.det(self._matrix())))
        out = np.empty(self.shape, np.float32)

        def work(start: int, stop: int) -> None:
            rows, columns = np.mgrid[start:stop, : self.shape[1]]
            place = np.stack(self.places(rows, columns))
            # the frame extends half a pixel beyond the outermost centres.
            place = np.where(np.abs(place - np.round(place)) < 1e-9, np.round(place), place)
            out[start:stop] = area * map_coordinates(prepared, place, order=spline, mode="constant", prefilter=False)

        for_each_chunk(work, self.shape[0], workers)
        if lost.any():
            out[(self.inside(data.shape, ~lost) == 0) & (self.inside(data.shape) > 0)] = np.nan
        return out

    def inside(self, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """Return the weights (0 or 1) of the pixels of the result, ``(rows, columns)``.

        They are 1 inside a frame of ``shape``, and 0 outside. With a ``mask`` of that shape, they are 1 only where the
        mask is True at all four surrounding pixels of the frame.
        """
        rows, columns = np.mgrid[: self.shape[0], : self.shape[1]]
        row, column = self.places(rows, columns)
        good = (row > -0.5) & (row < shape[0] - 0.5) & (column > -0.5) & (column < shape[1] - 0.5)
        if mask is not None:
            low = [np.clip(np.floor(v).astype(int), 0, n - 1) for v, n in ((row, shape[0]), (column, shape[1]))]
            high = [np.clip(v + 1, 0, n - 1) for v, n in zip(low, shape, strict=True)]
            # a resampled value depends on at least four pixels, which must all be good
            for r in (low[0], high[0]):
                for c in (low[1], high[1]):
                    good &= mask[r, c]
        return good.astype(np.float32)

    def _matrix(self) -> NDArray[np.float64]:
        """Return the map from pixels of the result to pixels of the frame, columns (down, across)."""
        return _invertible(self.down, self.across, self.period)


def _invertible(down: Pair, across: Pair, period: tuple[int, int]) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = np.array([down, across], float).T / np.array(period, float)
    if not abs(float(np.linalg.det(matrix))) > 1e-6:
        raise InputError.expected("lattice periods", "two directions", (down, across), "fit the lattice again")
    return matrix


def resampling_for(
    H: Any,
    shape: tuple[int, int],
    light_field: LightFieldSettings | None = None,
    placed: str = "",
    *,
    quiet: bool = True,
) -> Resampling | None:
    """Return the map that resamples frames of ``shape`` to the period of ``H``; None if they can be used unchanged.

    Frames can be used unchanged if the lattice drifts by at most `MOST_DRIFT` (px) over the frame. They can also be
    used unchanged if the lattice is unknown, or if ``placed`` is not empty. If ``light_field`` states whether to
    resample (see `LightFieldSettings.asked`), that applies instead. Create the projector with the map's ``shape`` and
    ``anchor(lattice_anchor_of(H))``.

    Parameters
    ----------
    H
        `PSFMatrix` of one region.
    shape
        Shape ``(rows, columns)`` of a frame (px).
    light_field
        Settings with a white image or a measured lattice. Without them, the lattice is that of H's camera, if frames
        show its entire sensor.
    placed
        Name of the setting that states the position of the frames in H, for messages; empty without such a setting.
    quiet
        Whether to omit notes and warnings.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.reconstruct import resampling_for
    >>> camera = preset("lfm_60x12")  # lenslets of 15.385 pixels
    >>> H = PSFMatrix(np.ones((1, 15, 15, 3, 3)), depths=[0.0], camera=camera, anchor=(1000, 1000))
    >>> view = resampling_for(H, camera.sensor.shape)
    >>> print(f"{view.drift(camera.sensor.shape):.1f} px of drift over {camera.sensor.shape[0]} rows")
    52.5 px of drift over 2048 rows
    """
    given = light_field or LightFieldSettings()
    if given.asked:
        return resampling_of(H, given)
    view = _known_resampling(H, shape, given, quiet)
    if view is None or view.drift(shape) <= MOST_DRIFT:
        return None
    as_they_are = given.asked is False or bool(placed)
    if not quiet and not as_they_are:
        note(
            f"{drift_words(view, shape)}; frames are resampled to this period (with --resample never, they are "
            "used unchanged)"
        )
    elif not quiet:
        remedy = f"frames whose position on the sensor comes from {placed} are not resampled" if placed else ""
        remedy = remedy or "to remove them, let frames be resampled (leave --resample never out)"
        warn(f"{drift_words(view, shape)}, so volumes show ghosts; {remedy}")
    return None if as_they_are else view


def _known_resampling(
    H: Any, shape: tuple[int, int], light_field: LightFieldSettings, quiet: bool
) -> Resampling | None:
    """Return the map based on the lattice in the white image, or else on that of H's camera; None if unknown."""
    if light_field.white:
        try:
            return resampling_of(H, light_field)
        except InputError as error:
            if not quiet:
                note(f"the lattice could not be measured in the white image: {error}")
    return Resampling.of_camera(H.camera, H.period, lattice_anchor_of(H)) if _is_whole(H.camera, shape) else None


def resampling_of(H: Any, light_field: LightFieldSettings) -> Resampling:
    """Return the map from frames to H's period, based on a measured lattice, else a white image, else H's camera.

    Raises
    ------
    InputError
        If none of them is known, or the measured lattice is not of the kind of H's camera.
    """
    from lfcal.frames.corrections import read_average
    from lfcal.lattice import fit_lattice, load_lattice

    white = read_average(light_field.white) if light_field.white else None
    kind = None if H.camera is None else H.camera.lattice.kind
    if light_field.lattice:
        fit = load_lattice(light_field.lattice)
        if kind not in (None, fit.kind):
            name = str(light_field.lattice)
            raise InputError.expected(
                name, f"the {kind} lattice of H", fit.kind, "use a white image or lattice of the same camera"
            )
    elif white is not None:
        fit = fit_lattice(white, kind=kind)
    elif H.camera is not None:
        return Resampling.of_camera(H.camera, H.period, lattice_anchor_of(H))
    else:
        raise InputError.expected(
            "--resample",
            "a white frame, a lattice, or a camera with H",
            "none",
            "give a white image or a measured lattice (--white or --lattice)",
        )
    if H.camera is None or len(H.camera.lattice.types) == 1:
        return Resampling.of_fit(fit, H.period, lattice_anchor_of(H))
    return Resampling.of_camera(_measured(H.camera, fit, white), H.period, lattice_anchor_of(H))


def _measured(camera: Camera, fit: LatticeFit, white: NDArray[np.float32] | None) -> Camera:
    """Return a ``camera`` with three lens types, with the lattice of ``fit``; its offset is at a type-0 lenslet.

    The type of each lenslet is determined in the white image. Without a result, the lenslet nearest to the stated
    offset is of type 0.
    """
    from lfcal.lattice import classify_lens_types, expected_blur

    lattice = fit.to_lattice(camera)
    if white is not None:
        try:
            lattice = classify_lens_types(white, fit, expected_blur(camera)).to_lattice(fit, camera)
        except InputError as error:
            note(f"lens types are taken from the camera of H, because they could not be measured: {error}")
    return replace(camera, lattice=lattice)


def drift_note(camera: Any, period: tuple[int, int], shape: tuple[int, int]) -> str:
    """Return a message if frames of ``shape`` must be resampled to ``period`` ``(ny, nx)``, otherwise an empty string.

    It is also empty if frames do not show the entire sensor of ``camera``.
    """
    if not _is_whole(camera, shape):
        return ""
    view = Resampling.of_camera(camera, period)
    if view.drift(shape) <= MOST_DRIFT:
        return ""
    return f"{drift_words(view, shape)}; resample frames with lfcal.reconstruct.resample.resampling_for"


def _is_whole(camera: Any, shape: tuple[int, int]) -> bool:
    """Return whether ``camera`` has a lattice, and its whole sensor has ``shape``; False if ``camera`` is None."""
    return camera is not None and camera.has_lattice and tuple(shape) == tuple(camera.sensor.shape)


def drift_words(view: Resampling, shape: tuple[int, int]) -> str:
    """Return a clause stating the drift of the lattice over frames of ``shape`` relative to the period of ``view``."""
    ny, nx = view.period
    return f"the lattice drifts by {view.drift(shape):.3g} px over the frame relative to H's period of {ny} x {nx} px"


def lattice_anchor_of(H: Any) -> Pair:
    """Return the offset (row, column) of the image of H's position (0, 0) from the nearest micro-image centre.

    It is in pixels of H, and is computed from camera and anchor of a `PSFMatrix`. If there are three lens types, only
    micro-images of type 0 count. Without a camera, position (0, 0) is assumed to be half a period above and to the left
    of a micro-image centre.
    """
    ny, nx = H.shape[1:3]
    camera = H.camera
    if camera is None:
        return -(ny - 1) / 2, -(nx - 1) / 2
    camera = camera.local(H.anchor)
    x, y = np.asarray(camera.sensor_um(H.anchor), float) - np.array(camera.lattice.offset_um)
    basis = np.asarray(camera.lattice.basis_um(), float)
    if len(camera.lattice.types) == 3:  # only lenslets of type 0
        basis = np.array([basis[0] + basis[1], 2 * basis[1] - basis[0]])
    inverse = np.linalg.inv(basis)
    residual = np.array([x, y]) - np.round(np.array([x, y]) @ inverse) @ basis
    size_y, size_x = camera.period_px
    scale = ny / max(1, round(ny / size_y)) / size_y, nx / max(1, round(nx / size_x)) / size_x
    pixel = camera.sensor.pixel_um
    return float(residual[1] / pixel * scale[0]), float(residual[0] / pixel * scale[1])
