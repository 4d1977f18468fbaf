"""Result of fitting a lattice to a white image."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, format_pixels
from lfcal.camera import Camera, LatticeDistortion, LensletLattice
from lfcal.lattice._forms import DistortionFrame, FittedForm, design
from lfcal.lattice._model import LatticeModel

__all__ = ["LatticeErrors", "LatticeFit", "best_places", "gridded", "outline_of", "within_outline"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LatticeErrors:
    """Standard errors of the parameters of a fitted lattice, estimated with the weights of the fit.

    Attributes
    ----------
    pitch_px, row_pitch_px, rotation_rad, shear_rad, origin_px
        Errors of the parameters of the same name; 0 if a parameter is not free.
    terms, centre
        Errors of the distortion's terms in their order, and of its centre (column, row) (pixels).
    covariance
        Covariance of all free parameters, in the order of `lfcal.lattice._forms.design`.
    """

    pitch_px: float
    row_pitch_px: float
    rotation_rad: float
    shear_rad: float
    origin_px: tuple[float, float]
    terms: tuple[tuple[float, ...], ...]
    centre: tuple[float, float]
    covariance: Array = field(repr=False)

    @classmethod
    def of(cls, fitted: FittedForm, covariance: Array, frame: DistortionFrame) -> LatticeErrors:
        """Return the errors of a fitted form from the covariance of its free parameters.

        ``frame`` contains the middle and the scale to which the distortion refers.
        """
        model, form = fitted.model, fitted.form
        unit = model.along / model.pitch
        rows = np.zeros((4, form.size))
        rows[0, 2:4] = unit
        rows[1, 2:4], rows[1, 4] = model.ratio * unit, model.pitch
        rows[2, 2:4] = np.array([-unit[1], unit[0]]) / model.pitch
        if form.sheared:
            rows[3, 5] = 1 / (1 + model.shear**2)
        place = design(model, form, np.zeros((1, 2), np.intp), frame)[::-1, 0]
        pitch, row, turn, shear, y, x = (math.sqrt(max(float(v @ covariance @ v), 0.0)) for v in (*rows, *place))
        single = np.sqrt(np.maximum(np.diag(covariance), 0.0))[6:].tolist()
        terms: tuple[tuple[float, ...], ...] = ()
        centre = (0.0, 0.0)
        if form.degree:
            terms = (tuple(single[: len(single) // 2]), tuple(single[len(single) // 2 :]))
        elif form.radial:
            terms, centre = (tuple(single[: form.radial]),), (single[-2], single[-1])
        return cls(pitch, row, turn, shear, (y, x), terms, centre, covariance)


@dataclass(frozen=True, eq=False)
class LatticeFit:
    """A fitted lattice of micro-images, and the quality of the fit.

    Frame coordinates (row, column) are relative to the centre of the first pixel; rows are counted downwards.

    Attributes
    ----------
    kind
        Kind of lattice: ``"square"`` or ``"hexagonal"``.
    shape
        Shape ``(rows, columns)`` of the frame (px).
    pitch_px, row_pitch_px
        Distance between adjacent micro-images along a row, and between adjacent rows (px).
    rotation_rad
        Angle (rad) from the +x (column) axis to a row of micro-images, positive towards +y (down).
    origin_px
        Centre ``(row, column)`` of the lenslet with q = r = 0, which is nearest to the centre of the frame (px).
    pitch_error_px
        Standard error of ``pitch_px`` (px).
    shear_rad
        Deviation (rad) of the angle between the lattice vectors from the ideal angle; 0 if it is not significant.
    residual_rms_px
        Rms distance (px), along one axis, of the located micro-images from the lattice including its distortion.
    index
        Indices (q, r) of the n lenslets that are completely in the frame, ``(n, 2)``; q counts along a row, and r
        counts the rows.
    measured_px
        Located centres (row, column) of these lenslets (px), ``(n, 2)``; NaN for dead lenslets.
    light
        Mean light within half a pitch of the centre of each lenslet, ``(n,)``, in counts.
    dead
        True for lenslets that are too dark or cannot be located, ``(n,)``.
    distortion
        Displacement from the undistorted lattice as a function of the point (column, row) (px). None: no distortion.
        Pitch, row pitch, rotation and shear describe the undistorted lattice.
    errors
        Standard errors of the lattice parameters; None if unknown.
    form, reason
        Selected form of the lattice (straight, or a kind of distortion), and the reason for the selection, as text.
    places_px
        Best estimate of the centre (row, column) of every lenslet, including dead ones (px), ``(n, 2)``. It is the
        position in the lattice plus the common deviation of the neighbours.
    notes
        Reasons to doubt that the frame is a white image, and limitations of the fit, one line each.
    outline_px
        Corners (row, column) of the convex hull of the located micro-images (px), ``(m, 2)``, outside which the lattice
        is extrapolated. None if the file of the lattice does not contain it.

    Examples
    --------
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import LatticeFit, fit_lattice
    >>> fit: LatticeFit = fit_lattice(read_image("session/white/white_0.png"), dark=64.0)
    >>> print(fit.form, fit.dead_lenslets, fit.centres_px([0, 1], 0).round(1).tolist())
    affine [] [[39.5, 47.5], [39.5, 58.5]]
    """

    kind: str
    shape: tuple[int, int]
    pitch_px: float
    row_pitch_px: float
    rotation_rad: float
    origin_px: tuple[float, float]
    pitch_error_px: float
    shear_rad: float
    residual_rms_px: float
    index: NDArray[np.intp] = field(repr=False)
    measured_px: Array = field(repr=False)
    light: Array = field(repr=False)
    dead: NDArray[np.bool_] = field(repr=False)
    distortion: LatticeDistortion | None = None
    errors: LatticeErrors | None = field(default=None, repr=False)
    form: str = "affine"
    reason: str = ""
    places_px: Array | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()
    outline_px: Array | None = None

    def basis_px(self) -> Array:
        """Return the undistorted lattice vectors (x, y) as rows of an array (px): along a row, and to the next row."""
        return self.model.basis()

    @cached_property
    def model(self) -> LatticeModel:
        """Model of the lattice, whose points are (x, y) = (column, row) in px."""
        along = self.pitch_px * np.array([math.cos(self.rotation_rad), math.sin(self.rotation_rad)])
        ratio, origin = self.row_pitch_px / self.pitch_px, np.array(self.origin_px[::-1], float)
        if self.distortion is not None:
            origin = self.distortion.invert(origin)
        return LatticeModel(self.kind, origin, along, ratio, math.tan(self.shear_rad), self.distortion)

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the centres (row, column), ``(..., 2)``, of lenslets (q, r), including the distortion (px)."""
        index = np.stack(np.broadcast_arrays(np.asarray(q, float), np.asarray(r, float)), axis=-1)
        return self.model.places(index)[..., ::-1]

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the fractional lattice indices (q, r), ``(..., 2)``, of the points (``row``, ``column``) in px.

        This is the inverse of `centres_px`.
        """
        points = np.stack(np.broadcast_arrays(np.asarray(column, float), np.asarray(row, float)), axis=-1)
        return self.model.indices(points)

    def residual_map(self, size: int = 48) -> Array:
        """Return the mean residual (row, column) in the cells of a grid over the frame, ``(2, rows, columns)`` (px).

        Residuals are located minus fitted centres. The grid has ``size`` cells along the longer side of the frame.
        Cells without a located lenslet are NaN.
        """
        residual = self.measured_px - self.centres_px(self.index[:, 0], self.index[:, 1])
        return gridded(self.measured_px, residual, self.shape, size)

    @property
    def dead_lenslets(self) -> list[tuple[int, int]]:
        """Lattice indices (q, r) of the dead lenslets, which are too dark or cannot be located."""
        return [(int(q), int(r)) for q, r in self.index[self.dead]]

    def to_lattice(
        self, camera: Camera, *, origin: tuple[int, int] | None = None, type_step: int | None = None
    ) -> LensletLattice:
        """Return a copy of the lattice of ``camera`` with the measured pitches, rotation, shear, offset and distortion.

        The clear diameter is adapted to the measured pitch.

        Parameters
        ----------
        camera
            Camera with which the frame was recorded; its lens types and gap remain unchanged.
        origin
            Lenslet (q, r) whose centre becomes the offset. With three lens types, it must be of type 0. None: the
            lenslet nearest to the current offset.
        type_step
            Type (1 or 2) of the lenslet that follows a type-0 lenslet along a row. None: unchanged.

        Raises
        ------
        InputError
            If the kind of the lattice or the shape of the frame differs from that of ``camera``.
        """
        if camera.sensor.shape != self.shape:
            raise InputError.expected(
                "white image",
                f"{format_pixels(camera.sensor.shape)}, as the camera has",
                format_pixels(self.shape),
                "choose the camera that recorded it",
            )
        stated = camera.periodic
        if stated.kind != self.kind:
            raise InputError.expected(
                "lattice of the white image", stated.kind, self.kind, "correct the kind of lattice in the camera"
            )
        pixel = camera.sensor.pixel_um
        if origin is None:
            row, column = camera.pixels(stated.offset_um)
            q, r = np.rint(self.lenslet_at(row, column)).astype(int)
            origin = (int(q), int(r))
        straight = self.model.straight(np.array(origin))
        offset = camera.sensor_um(straight[::-1])
        centre = camera.sensor.centre_px
        distortion = self.distortion
        if distortion is not None:
            distortion = distortion.scaled(pixel, (-pixel * centre[1], -pixel * centre[0]))
        return replace(
            stated,
            pitch_um=self.pitch_px * pixel,
            row_pitch_um=self.row_pitch_px * pixel,
            rotation_rad=self.rotation_rad,
            offset_um=(float(offset[0]), float(offset[1])),
            clear_um=stated.clear_of(self.pitch_px * pixel),
            type_step=stated.type_step if type_step is None else type_step,
            shear_rad=self.shear_rad,
            distortion=distortion,
        )


def outline_of(places: Array) -> Array:
    """Return the corners ``(m, 2)`` of the convex hull of ``places`` ``(n, 2)``, in their order along the hull."""
    from scipy.spatial import ConvexHull

    corners: Array = places[ConvexHull(places).vertices]
    return corners


def within_outline(places: Array, outline: Array) -> NDArray[np.bool_]:
    """Return a mask ``(n,)`` of the points ``places`` ``(n, 2)`` inside a convex ``outline``, or at most 1 px outside.

    ``outline`` ``(m, 2)`` contains its corners in order, as returned by `outline_of`.
    """
    side = np.roll(outline, -1, axis=0) - outline
    away = places[:, None] - outline
    turn = side[:, 0] * away[..., 1] - side[:, 1] * away[..., 0]
    limit = np.hypot(*side.T)
    inside: NDArray[np.bool_] = (turn >= -limit).all(1) | (turn <= limit).all(1)
    return inside


REACH = 3
"""Extent of the averaging over neighbours, in lattice indices on each side."""

SPREAD = 1.5
"""Standard deviation of the neighbours' weights, in lattice indices."""


def best_places(index: NDArray[np.intp], lattice: Array, measured: Array) -> Array:
    """Return the best estimates ``(n, 2)`` of the lenslets' positions (pixels).

    The estimate is the position in the lattice plus a fraction of the weighted mean deviation of the neighbours. The
    fraction is the part of this mean that is common to the neighbours (James and Stein 1961). Suppose that the
    deviations were only scatter. The variance of the mean with the weights w would then be sum(w²)/sum(w)² times that
    of a single deviation. If too few positions are measured, the estimate is the position in the lattice.

    Parameters
    ----------
    index
        ``(n, 2)``: lattice indices (q, r).
    lattice
        ``(n, 2)``: positions in the lattice (pixels).
    measured
        ``(n, 2)``: measured positions (pixels); NaN where there is none.
    """
    residual = measured - lattice
    known: NDArray[np.bool_] = np.asarray(np.isfinite(residual).all(1))
    if known.sum() < 3 * (2 * REACH + 1) ** 2:
        return lattice
    # one outlier is not a common displacement
    distance = np.hypot(*residual[known].T)
    limit = 4 * float(np.median(distance)) / 1.1774
    inliers = known.copy()
    inliers[known] = distance <= limit
    mean, noise = _means(index, np.where(inliers[:, None], residual, 0.0), inliers)
    single = float((residual[inliers] ** 2).mean())
    common = float((mean[inliers] ** 2).mean())
    scatter = single * float(noise[inliers].mean())
    share = max(0.0, 1 - scatter / common) if common > 0 else 0.0
    result: Array = lattice + share * mean
    return result


def _means(index: NDArray[np.intp], values: Array, inliers: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return weighted means ``(n, 2)`` over the neighbours without the lenslet itself, and their noise factors."""
    from scipy import ndimage

    place = index - index.min(0)
    shape = tuple(place.max(0) + 1)
    steps = np.arange(-REACH, REACH + 1)
    line = np.exp(-0.5 * (steps / SPREAD) ** 2)
    kernel = line[:, None] * line
    kernel[REACH, REACH] = 0.0
    grids = np.zeros((3, *shape))
    grids[:, place[:, 0], place[:, 1]] = *values.T, inliers
    total = [ndimage.correlate(g, kernel, mode="constant")[place[:, 0], place[:, 1]] for g in grids]
    squares = ndimage.correlate(grids[2], kernel**2, mode="constant")[place[:, 0], place[:, 1]]
    count = np.maximum(total[2], 1e-12)
    enough = total[2] > 0.2 * kernel.sum()
    means = np.where(enough[:, None], np.stack(total[:2], axis=-1) / count[:, None], 0.0)
    return means, np.where(enough, squares / count**2, 0.0)


def gridded(places: Array, values: Array, shape: tuple[int, int], size: int) -> Array:
    """Return the mean of ``values`` ``(n, 2)`` in each cell of a grid, ``(2, rows, columns)``; NaN in empty cells.

    The grid has ``size`` cells along the longer side of a frame of ``shape``. ``places`` ``(n, 2)`` are the positions
    (row, column) of the values; NaN values are ignored.
    """
    known = np.isfinite(places).all(1) & np.isfinite(values).all(1)
    cell = max(shape) / size
    counts = tuple(max(1, math.ceil(n / cell)) for n in shape)
    row, column = np.clip((places[known] / cell).astype(np.intp), 0, np.array(counts) - 1).T
    number = np.bincount(row * counts[1] + column, minlength=counts[0] * counts[1]).astype(float)
    sums = [np.bincount(row * counts[1] + column, weights=v, minlength=counts[0] * counts[1]) for v in values[known].T]
    with np.errstate(invalid="ignore"):
        means: Array = np.stack([s / np.where(number > 0, number, np.nan) for s in sums]).reshape(2, *counts)
    return means
