"""Scan plan: the source positions to record, their coordinates, and their order."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import (
    FileFormatError,
    InputError,
    Position,
    check_choice,
    check_cutout,
    check_number,
    check_tuple,
    check_type,
    parse_json,
    stated_format,
)
from lfcal.camera.description import Camera, build, nearest_lens
from lfcal.camera.main_lens import Microscope
from lfcal.camera.shadow import cutout_for
from lfcal.camera.stage import StageAxes

__all__ = [
    "MAX_WAIT_S",
    "HalfCell",
    "ScanPlan",
    "checked_depths",
    "checked_exposures",
    "depths_of",
    "half_cell",
    "moved_onto_sensor",
]

MAX_DEFOCUS = 0.5
"""Largest ratio of depth to an objective's focal length for which the aperture of the focal plane is used; at -1 the
source would be in the lens."""

MAX_WAIT_S = 86_400.0
"""Longest exposure or wait (s), a day: longer ones are typing errors, and their sum over positions would overflow."""


def depths_of(camera: Camera, depths: Iterable[float] | None, virtual: Iterable[float] | None) -> tuple[float, ...]:
    """Return object depths (µm): ``depths`` (µm), or those of the virtual depths ``virtual``; give one of the two."""
    if (depths is None) == (virtual is None):
        raise InputError.expected(
            "depth planes",
            "depths in µm or virtual depths",
            "neither" if depths is None else "both",
            "give one of the two",
        )
    values: Sequence[float] = tuple(depths if depths is not None else () if virtual is None else virtual)
    for value in values:
        check_number("depth", value)
    return tuple(values) if depths is not None else tuple(camera.depth_of(v) for v in values)


def checked_depths(camera: Camera, depths: Sequence[float]) -> tuple[float, ...]:
    """Return the depths (µm) after checking them.

    Raises
    ------
    InputError
        If the camera does not image a depth, or a depth is too far from the focal plane of a microscope. Also if the
        depths are neither strictly increasing nor strictly decreasing.
    """
    checked = check_tuple("depths (µm)", depths)
    for z in checked:
        # raises if the main lens does not image the plane
        camera.step_um(z)
        if isinstance(camera.optics, Microscope):
            _check_near(camera.optics, z)
    steps = np.diff(np.array(checked))
    if steps.size and not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError.expected(
            "depths (µm)",
            "depths in increasing or decreasing order",
            ", ".join(f"{z:g}" for z in checked),
            "sort the depths and remove repetitions",
        )
    return checked


def _check_near(optics: Microscope, z_um: float) -> None:
    """Raise `InputError` unless the depth is so close to the focal plane that the objective's cone can be used."""
    focal = optics.medium_index * optics.tube_length_um / optics.magnification
    if not abs(z_um) < MAX_DEFOCUS * focal:
        share = f"{MAX_DEFOCUS:g} of the objective's focal length"
        limit = f"within {MAX_DEFOCUS * focal:.6g} µm of the focal plane ({share})"
        raise InputError.expected("depth", limit, f"{z_um:g} µm", "choose a plane nearer to the focal plane")


def checked_exposures(given: float | Sequence[float], planes: int) -> tuple[float, ...]:
    """Return the exposure time (s) of each of ``planes`` planes; one number, or a sequence of one, applies to all."""
    # JSON writes one exposure for all planes as a list of one
    given = given.tolist() if isinstance(given, np.ndarray) else given
    several = isinstance(given, list | tuple) and len(given) != 1
    values = check_tuple(
        "exposures (s), one for all planes or one per plane",
        given if isinstance(given, list | tuple) else [given],
        planes if several else 1,
        above=0,
        at_most=MAX_WAIT_S,
    )
    return values if several else values * planes


FORMAT = "lfcal-plan"
VERSION = 1
# far more than any recording (25 days at a frame per millisecond): catches wrong periods and depth lists
MAX_POSITIONS = 1 << 31
ON_SENSOR: dict[str, float] = {"at_least": -1e6, "at_most": 1e6}
"""Limits of the anchor (px): outside every sensor, and small enough for calculations."""
MAX_TILT_RAD = math.radians(2.0)
"""Largest rotation (rad) for which the rectangular period describes the array."""


@dataclass(frozen=True, slots=True)
class ScanPlan:
    """Plan of a scan: the positions of a point source, and the part of each frame to record.

    At the position with the indices ``(z, y, x)``, the image of the source along the chief ray is at
    ``anchor + (y, x)`` in every depth plane. The lateral step in object space, `step_um`, therefore depends on the
    depth.

    Attributes
    ----------
    camera
        The camera to calibrate.
    period
        Number of source positions ``(ny, nx)`` in a plane, which cover a representative cell of the lenslet array.
    cutout
        Number of rows and columns ``(nt, ns)`` to record around the image (px); both are odd.
    depths_um
        Object depth of each plane (µm, relative to the working plane, positive away from the camera), in ascending or
        descending order.
    anchor
        Sensor position ``(row, column)`` of the image at y = x = 0 (px); integers are pixel centres.
    stage
        Relation between the stage axes and the motion of the image.
    order
        Scan order: ``"serpentine"`` (without long return moves) or ``"raster"`` (every row starts at the same side).
    exposure_s
        Exposure time of each plane, or one exposure time for all planes (s).
    settle_s
        Waiting time after each move (s).
    frames_averaged
        Number of frames recorded and averaged at each position.
    resample
        Whether frames are scaled by `resample_factors` such that the period is a whole number of pixels. The steps and
        the cutout are then in resampled pixels, and the anchor is in sensor pixels.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63)
    >>> print(plan.period, plan.shape, plan.n_positions)
    (19, 33) (1, 19, 33, 63, 63) 627
    >>> print(plan.image_px([[0, 0, 0], [0, 0, 1], [0, 1, 0]]).tolist())
    [[150.0, 144.0], [150.0, 145.0], [151.0, 144.0]]
    """

    camera: Camera
    period: tuple[int, int]
    cutout: tuple[int, int]
    depths_um: tuple[float, ...]
    anchor: tuple[float, float]
    stage: StageAxes = field(default_factory=StageAxes)
    order: str = "serpentine"
    exposure_s: float | tuple[float, ...] = 0.02
    settle_s: float = 0.05
    frames_averaged: int = 1
    resample: bool = False

    def __post_init__(self) -> None:
        """Check every value, and that all cutouts are on the sensor."""
        check_type("camera", self.camera, Camera)
        check_type("stage axes", self.stage, StageAxes)
        check_type("resample", self.resample, bool)
        for name in ("period", "cutout"):
            value = check_tuple(f"{name} (rows, columns)", getattr(self, name), 2, integer=True, at_least=1)
            object.__setattr__(self, name, value)
        check_cutout(*self.cutout)
        object.__setattr__(self, "anchor", check_tuple("anchor (row, column)", self.anchor, 2, **ON_SENSOR))
        object.__setattr__(self, "depths_um", checked_depths(self.camera, self.depths_um))
        object.__setattr__(self, "exposure_s", checked_exposures(self.exposure_s, len(self.depths_um)))
        check_choice("scan order", self.order, ("serpentine", "raster"))
        check_number("settle time (s)", self.settle_s, at_least=0, at_most=MAX_WAIT_S)
        check_number("frames averaged", self.frames_averaged, at_least=1, at_most=100_000, integer=True)
        check_number("positions", self.n_positions, at_least=1, at_most=MAX_POSITIONS, integer=True)
        if abs(self.cell_camera.lattice.tilt_rad) > MAX_TILT_RAD:
            tilt = f"{math.degrees(self.cell_camera.lattice.tilt_rad):.2f}°"
            raise InputError.expected(
                "lattice rotation",
                "rows within 2° of a sensor axis",
                tilt,
                "make the rows of the camera's lattice parallel to the sensor, or rotate the frames",
            )
        _check_on_sensor(self)

    # -- construction ----------------------------------------------------------------------------------
    @classmethod
    def for_camera(
        cls,
        camera: Camera,
        *,
        depths_um: Iterable[float] | None = None,
        virtual_depths: Iterable[float] | None = None,
        cutout: int | tuple[int, int] | None = None,
        anchor: tuple[float, float] | None = None,
        stage: StageAxes | None = None,
        order: str = "serpentine",
        exposure_s: float | tuple[float, ...] = 0.02,
        settle_s: float = 0.05,
        frames_averaged: int = 1,
        resample: bool = False,
    ) -> ScanPlan:
        """Return the plan that covers a representative cell of the camera's lenslet array.

        Parameters
        ----------
        camera
            Camera to calibrate.
        depths_um, virtual_depths
            Depth planes, as object depths (µm) or as virtual depths; exactly one of the two must be given.
        cutout
            Number of pixels to record around the image, one number or ``(nt, ns)``. None: a square that covers the
            geometric pattern at every depth, with a margin for diffraction by the lenslets. Without a lattice, this
            square is limited to the sensor.
        anchor
            As in `ScanPlan`. None: the cell is centred on the sensor's centre to the nearest pixel. Without a lattice,
            the single position is at the pixel nearest to the optical axis.
        stage, order, exposure_s, settle_s, frames_averaged, resample
            As in `ScanPlan`.

        Raises
        ------
        InputError
            If no plan is possible with these values.
        """
        depths = depths_of(camera, depths_um, virtual_depths)
        if anchor is not None:
            check_tuple("anchor (row, column)", anchor, 2, **ON_SENSOR)
        cell = camera.local(camera.sensor.centre_px if anchor is None else anchor)
        ny, nx = (max(1, round(length)) for length in cell.period_px)
        if cutout is None:
            cutout = cutout_for(camera, depths)
        if anchor is None:
            # on whole pixels, so that cutouts need no interpolation
            middle = camera.sensor.centre_px
            row, column = middle if camera.has_lattice else nearest_lens(camera, middle)
            anchor = (float(round(row - (ny - 1) / 2)), float(round(column - (nx - 1) / 2)))
        window = cutout if isinstance(cutout, tuple | list) else (cutout, cutout)
        return cls(
            camera,
            (ny, nx),
            window,
            depths,
            anchor,
            stage=stage or StageAxes(),
            order=order,
            exposure_s=exposure_s,
            settle_s=settle_s,
            frames_averaged=frames_averaged,
            resample=resample,
        )

    # -- sizes -----------------------------------------------------------------------------------------
    @property
    def cell_camera(self) -> Camera:
        """Copy of the camera with an undistorted lattice that approximates its lattice near the anchor."""
        return self.camera.local(self.anchor)

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape ``(nz, ny, nx, nt, ns)`` of H: planes, source positions, pixels of the cutout."""
        return (len(self.depths_um), *self.period, *self.cutout)

    @property
    def scan(self) -> ScanPlan:
        """The plan itself; for the plan of a target or of regions, the scan plan on which it is based."""
        return self

    @property
    def n_positions(self) -> int:
        """Total number of source positions, over all planes."""
        return len(self.depths_um) * self.period[0] * self.period[1]

    @property
    def exposures(self) -> tuple[float, ...]:
        """Exposure time of each plane (s)."""
        one = self.exposure_s
        return one if isinstance(one, tuple) else (one,) * len(self.depths_um)

    @property
    def virtual_depths(self) -> tuple[float, ...]:
        """Virtual depth of each plane (`Camera.virtual_depth`); empty for a camera without a lattice."""
        if not self.camera.has_lattice:
            return ()
        return tuple(self.camera.virtual_depth(z) for z in self.depths_um)

    @property
    def cells(self) -> tuple[int, int]:
        """Number of rectangular array periods ``(y, x)`` in the plan's period (nearest integer), usually (1, 1)."""
        ny, nx = (max(1, round(n / p)) for n, p in zip(self.period, self.cell_camera.period_px, strict=True))
        return ny, nx

    @property
    def period_residual_px(self) -> tuple[float, float]:
        """Rounding residual ``(y, x)`` of the period (px): `cells` periods of the array minus that of the plan."""
        y, x = (k * p - n for k, p, n in zip(self.cells, self.cell_camera.period_px, self.period, strict=True))
        return y, x

    @property
    def drift_px(self) -> float:
        """Difference (px) of array and plan periods, accumulated over the sensor; the larger of the axes' values."""
        sides = zip(self.period_residual_px, self.camera.sensor.shape, self.period, strict=True)
        return max(abs(residual) * side / period for residual, side, period in sides)

    @property
    def tilt_residual_px(self) -> float:
        """Signed sideways shift (px) of a lenslet row over the longer side of the period, due to its tilt."""
        return max(self.period) * math.tan(self.cell_camera.lattice.tilt_rad)

    @property
    def resample_factors(self) -> tuple[float, float]:
        """Number of resampled pixels per sensor pixel ``(fy, fx)``; (1, 1) if `resample` is false.

        Pixel i of a resampled frame is at the sensor pixel i / factor.
        """
        if not self.resample:
            return 1.0, 1.0
        # a cell is a whole number of lattice periods, scaled to a whole number of pixels
        fy, fx = (n / (k * p) for k, p, n in zip(self.cells, self.cell_camera.period_px, self.period, strict=True))
        return fy, fx

    @property
    def lattice_anchor(self) -> tuple[float, float]:
        """Offset ``(row, column)`` of the anchor from the centre of the nearest type-0 micro-image (sensor pixels)."""
        row, column = nearest_lens(self.camera, self.anchor)
        return self.anchor[0] - row, self.anchor[1] - column

    # -- positions -------------------------------------------------------------------------------------
    def step_um(self, z: int) -> tuple[float, float]:
        """Return the steps ``(y, x)`` in object space (µm) that move the image by one pixel of H in plane ``z``."""
        step = self.camera.step_um(self.depths_um[z])
        fy, fx = self.resample_factors
        return step / fy, step / fx

    def image_px(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Return the image positions (row, column), ``(..., 2)``, of source positions (z, y, x), in sensor pixels."""
        index = np.asarray(positions, float)
        result: NDArray[np.float64] = np.array(self.anchor) + index[..., 1:] / np.array(self.resample_factors)
        return result

    def object_um(self, positions: ArrayLike) -> NDArray[np.float64]:
        """Return the object points (right, down, away), ``(..., 3)``, of source positions (z, y, x), in µm.

        Lateral coordinates are relative to the optical axis (the sensor's centre) and have the sign of the image
        motion. The third coordinate, away from the camera, is relative to the working plane.
        """
        index = np.asarray(positions)
        planes = index[..., 0].astype(np.intp)
        steps = np.array([self.camera.step_um(z) for z in self.depths_um])[planes]
        offset = self.image_px(index) - np.array(self.camera.sensor.centre_px)
        depth = np.array(self.depths_um)[planes]
        return np.stack([offset[..., 1] * steps, offset[..., 0] * steps, depth], axis=-1)

    def stage_um(self, positions: ArrayLike | None = None) -> NDArray[np.float64]:
        """Return stage coordinates (x, y, z), ``(..., 3)`` (µm), of ``positions`` (z, y, x); None: all, in order."""
        return self.stage.to_stage(self.object_um(self.order_indices() if positions is None else positions))

    # -- order -----------------------------------------------------------------------------------------
    def order_indices(self) -> NDArray[np.intp]:
        """Return the indices (z, y, x) of all positions, ``(n, 3)``, in scan order.

        In serpentine order, the direction is reversed at the end of each row and of each plane, so that every move is
        one step.
        """
        return self._ordered(self.period[1])

    def _ordered(self, columns: int) -> NDArray[np.intp]:
        """Return the positions (z, y, x) in scan order for rows of ``columns`` positions."""
        nz, ny = len(self.depths_um), self.period[0]
        index = np.indices((nz, ny, columns), dtype=np.intp)
        if self.order == "serpentine":
            # odd planes run in reverse, so that each plane starts where the last one ended
            index[1, 1::2] = ny - 1 - index[1, 1::2]
            # counted over all planes, so the direction alternates across the change of plane too
            rows = index[2].reshape(nz * ny, columns)
            rows[1::2] = columns - 1 - rows[1::2]
        return index.reshape(3, -1).T

    def row_ends(self) -> NDArray[np.intp]:
        """Return the indices (z, y, x), ``(n, 3)``, of the first and last position of every row, in scan order.

        A row with a single position is included once.
        """
        columns = self.period[1]
        ends = self._ordered(min(columns, 2))
        ends[:, 2] *= columns - 1
        return ends

    def in_scan_order(self, positions: ArrayLike) -> NDArray[np.intp]:
        """Return the given positions (z, y, x) in scan order and without duplicates, ``(n, 3)``.

        Raises
        ------
        InputError
            If a position is outside the plan.
        """
        index = np.asarray(positions, np.intp).reshape(-1, 3)
        outside = ((index < 0) | (index >= np.array(self.shape[:3]))).any(axis=1)
        if outside.any():
            first = tuple(index[outside][0].tolist())
            raise InputError.expected(
                "position", f"(z, y, x) inside {self.shape[:3]}", first, "use a list of this plan"
            )
        wanted = np.zeros(self.shape[:3], np.bool_)
        wanted[tuple(index.T)] = True
        order = self.order_indices()
        found: NDArray[np.intp] = order[wanted[tuple(order.T)]]
        return found

    def positions(self) -> Iterator[Position]:
        """Return an iterator over all positions in scan order."""
        return map(Position._make, self.order_indices().tolist())

    # -- JSON ------------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Return the plan as plain JSON types."""
        return {"format": FORMAT, "version": VERSION, **asdict(self), "camera": self.camera.to_dict()}

    def to_json(self) -> str:
        """Return the plan as JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    @classmethod
    def is_one(cls, data: Any) -> bool:
        """Return whether ``data`` states the format of a scan plan; its contents are not checked."""
        return isinstance(data, Mapping) and data.get("format") == FORMAT

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ScanPlan:
        """Return the plan described by the result of `to_dict`.

        Another format or version, and unknown or missing entries, raise `FileFormatError`; invalid values raise
        `InputError`.
        """
        if not cls.is_one(data):
            raise FileFormatError.expected(
                "scan plan", f'"format": "{FORMAT}"', stated_format(data), "choose a plan made by lfcal plan"
            )
        if data.get("version") != VERSION:
            raise FileFormatError.expected("scan plan", f"version {VERSION}", data.get("version"), "update lfcal")
        body = {key: value for key, value in data.items() if key not in ("format", "version")}
        body["camera"] = Camera.from_dict(body.get("camera", {}))
        return build(cls, body, "scan plan")

    @classmethod
    def from_json(cls, text: str) -> ScanPlan:
        """Return the plan described by ``text``, as returned by `to_json`."""
        return cls.from_dict(parse_json(text, "scan plan"))


def _check_on_sensor(plan: ScanPlan) -> None:
    """Raise `InputError` unless the cutouts of all positions are on the sensor."""
    factors = plan.resample_factors
    for axis, name in enumerate(("row", "column")):
        size = plan.camera.sensor.shape[axis]
        half = (plan.cutout[axis] - 1) / 2 / factors[axis]
        centres = np.floor(plan.anchor[axis] + 0.5) + np.arange(plan.period[axis]) / factors[axis]
        # half a pixel of tolerance: the sensor ends at the edge of its last pixel, not at its centre
        outside = np.flatnonzero((centres - half < -0.5) | (centres + half > size - 0.5))
        if outside.size:
            k = int(outside[0])
            place = Position(0, k, 0) if axis == 0 else Position(0, 0, k)
            lo, hi = centres[k] - half, centres[k] + half
            raise InputError.expected(
                f"cutout of position z={place.z}, y={place.y}, x={place.x}",
                f"{name}s from 0 to {size - 1}",
                f"{name}s from {lo:.0f} to {hi:.0f}",
                "move the anchor inwards or choose a smaller cutout",
            )


def moved_onto_sensor(
    plan: ScanPlan, *, cutout: tuple[int, int] | None = None, anchor: tuple[float, float] | None = None
) -> ScanPlan:
    """Return a plan with another cutout or anchor, moved if necessary so that all cutouts are on the sensor.

    Along each axis, the scan is moved by the smallest sufficient multiple of the array's period, so that the patterns
    remain the same. Unless frames are resampled, this distance is rounded to whole pixels. If no such multiple is
    possible, the scan is moved by the smallest sufficient number of pixels.

    Parameters
    ----------
    plan
        Plan to move.
    cutout, anchor
        Size ``(nt, ns)`` of the cutout (px), and sensor position ``(row, column)`` of the anchor. None: those of
        ``plan``.

    Raises
    ------
    InputError
        If the area covered by all cutouts is larger than the sensor, or ``cutout`` is not a valid size.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, moved_onto_sensor, preset
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63, anchor=(40, 144))
    >>> moved_onto_sensor(plan, cutout=(101, 101)).anchor  # 19 positions are a period
    (59.0, 144.0)
    """
    window = plan.cutout if cutout is None else cutout
    check_cutout(*window)
    place, period_px = list(plan.anchor if anchor is None else anchor), plan.cell_camera.period_px
    for axis, name in enumerate(("rows", "columns")):
        low, high = _anchors_on_sensor(plan, window[axis], axis)
        if low > high:
            size = plan.camera.sensor.shape[axis]
            most = math.floor((size - _span(plan, axis)) * plan.resample_factors[axis])
            wanted = f"at most {most - 1 + most % 2} {name} on a sensor of {size}"
            raise InputError.expected("cutout", wanted, window[axis], "choose a smaller cutout")
        place[axis] = _nearest_place(plan, place[axis], plan.cells[axis] * period_px[axis], low, high)
    return replace(plan, cutout=window, anchor=(place[0], place[1]))


def _span(plan: ScanPlan, axis: int) -> float:
    """Return the distance from the first position to the last one along an axis (sensor pixels)."""
    return (plan.period[axis] - 1) / plan.resample_factors[axis]


def _anchors_on_sensor(plan: ScanPlan, cutout: int, axis: int) -> tuple[float, float]:
    """Return the smallest and the largest anchor pixel along an axis for which all cutouts are on the sensor."""
    half = (cutout - 1) / 2 / plan.resample_factors[axis]
    return math.ceil(half - 0.5), math.floor(plan.camera.sensor.shape[axis] - 0.5 - half - _span(plan, axis))


def _nearest_place(plan: ScanPlan, anchor: float, period_px: float, low: float, high: float) -> float:
    """Return ``anchor``, moved by whole periods, or else by whole pixels, until its pixel is ``low`` … ``high``."""
    pixel = math.floor(anchor + 0.5)
    if low <= pixel <= high:
        return anchor
    sign, away = (1, low - pixel) if pixel < low else (-1, pixel - high)
    shift = math.ceil(away / period_px) * period_px
    if not plan.resample:
        shift = round(shift) if round(shift) >= away else round(shift + period_px)
    moved = anchor + sign * shift
    return moved if low <= math.floor(moved + 0.5) <= high else anchor + sign * away


HALF_PERIOD_TOL_PX = 0.05
"""Largest deviation of half the array's period from whole pixels at which patterns half a period away are equal."""


@dataclass(frozen=True, slots=True)
class HalfCell:
    """Symmetry of a half cell: the pattern at (y, x) equals that at (y + shift[0], x + shift[1]), modulo the period.

    Attributes
    ----------
    period
        Number of positions ``(ny, nx)``.
    shift
        Half the period.
    residual_px
        Distance ``(y, x)`` (px) to the lenslet half an array period away, minus half the plan's period. There is such a
        lenslet on each of the two diagonals; along each axis, the distance with the larger magnitude is given.
    """

    period: tuple[int, int]
    shift: tuple[int, int]
    residual_px: tuple[float, float]

    def partners(self, positions: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the positions (z, y, x), ``(n, 3)``, half a period away from ``positions``, with the same patterns."""
        out = positions.copy()
        out[:, 1:] = (positions[:, 1:] + self.shift) % self.period
        return out

    def half(self, plan: ScanPlan) -> NDArray[np.intp]:
        """Return the positions (z, y, x), ``(n, 3)``, in the first half of the rows of every plane, in scan order."""
        order = plan.order_indices()
        found: NDArray[np.intp] = order[order[:, 1] < self.shift[0]]
        return found


def half_cell(plan: ScanPlan) -> HalfCell:
    """Return the symmetry that lets a plan scan half a cell, if patterns half a period apart are equal.

    Raises
    ------
    InputError
        If frames are resampled, or patterns half a period apart differ; the message states the reason. They differ if
        the plan's period is odd along an axis, or if there is no lenslet of the same type half a period away. They
        also differ if the distance to this lenslet is not half the plan's period to within 0.05 px along each axis.
    """
    ny, nx = plan.period
    what, remedy = "half-cell scan", "scan the whole period, or choose positions for a fit (lfcal plan fit)"
    if plan.resample:
        raise InputError.expected(what, "frames that are not resampled", "resampled frames", remedy)
    if ny % 2 or nx % 2:
        wanted = "an even number of pixels in both directions of the period"
        raise InputError.expected(what, wanted, f"{ny} x {nx}, half of which is not a whole number of pixels", remedy)
    lattice, pixel = plan.cell_camera.lattice, plan.camera.sensor.pixel_um
    basis = lattice.basis_um()
    worst = np.zeros(2)
    # beyond the period's edges, the partner lies on the other diagonal
    for dy, dx in ((ny / 2, nx / 2), (ny / 2, -nx / 2)):
        steps = np.array([dx, dy]) * pixel @ np.linalg.inv(basis)
        whole = np.rint(steps).astype(np.intp)
        x, y = (whole - steps) @ basis / pixel
        if max(abs(x), abs(y)) > 0.25 * lattice.pitch_um / pixel:
            got = f"none within {np.hypot(x, y):.1f} px of that point"
            raise InputError.expected(what, "a lenslet half a period from each lenslet", got, remedy)
        if int(lattice.type_of(*whole)) != int(lattice.type_of(0, 0)):
            raise InputError.expected(what, "lenslets of the same type half a period away", "another type", remedy)
        worst = np.where(np.abs((y, x)) > np.abs(worst) + 1e-9, (y, x), worst)
    if np.abs(worst).max() > HALF_PERIOD_TOL_PX:
        got = f"deviations of {worst[0]:+.3f} rows and {worst[1]:+.3f} columns"
        raise InputError.expected(
            what, f"half periods within {HALF_PERIOD_TOL_PX} px of a whole number of pixels", got, remedy
        )
    return HalfCell((ny, nx), (ny // 2, nx // 2), (float(worst[0]), float(worst[1])))
