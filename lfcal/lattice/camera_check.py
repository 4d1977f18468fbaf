"""Comparison of a camera's description with a white image: agreement, differences, and the measured camera."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, format_count
from lfcal.camera import Camera, LensletLattice
from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.lens_types import LensTypes, classify_lens_types, expected_blur

__all__ = ["DIFFERS", "FITS", "FIT_PX", "UNKNOWN", "WRONG", "CameraCheck", "CheckLine", "check_camera"]

FITS, DIFFERS, WRONG, UNKNOWN = "fits", "differs", "does not fit", "was assumed"

FIT_PX = 0.3
"""Largest displacement at the frame's edge for a value that fits (pixels)."""

MEASURED = ("pitch_um", "row_pitch_um", "rotation_rad", "shear_rad", "offset_um", "distortion")


@dataclass(frozen=True, slots=True)
class CheckLine:
    """One value of the camera, compared with the white image.

    Attributes
    ----------
    label
        Name of the value.
    expected, measured
        Described and measured value with units; the measured value includes its standard error, if known.
    edge_px
        Displacement of a micro-image due to the difference (pixels): at the frame's edge, or the rms distance from the
        lattice. None: the value does not displace micro-images.
    verdict
        `FITS`, `DIFFERS`, `WRONG`, or `UNKNOWN` if the expected value was only assumed.
    """

    label: str
    expected: str
    measured: str
    edge_px: float | None
    verdict: str


@dataclass(frozen=True, slots=True)
class CameraCheck:
    """Comparison of a camera with a white image: a line for each value, lattice fit, lens types, and measured camera.

    If the kind of lattice differs, ``camera`` is None; if the shape of the frame differs, ``fit`` is None as well.
    ``types`` is None if the lens types were not determined.
    """

    data: ClassVar[str] = "camera"

    lines: tuple[CheckLine, ...]
    fit: LatticeFit | None
    camera: Camera | None
    types: LensTypes | None = None

    @property
    def known(self) -> str:
        """Text with the number of values that the white image confirms, out of all compared values."""
        fits = sum(line.verdict == FITS for line in self.lines)
        return f"confirmed by the white image in {fits} of {format_count(len(self.lines), 'value', 'values')}"

    @property
    def verdict(self) -> str:
        """The worst verdict of all lines; lines with assumed values do not count."""
        found = {line.verdict for line in self.lines}
        return next((verdict for verdict in (WRONG, DIFFERS) if verdict in found), FITS)


def check_camera(
    camera: Camera,
    white: ArrayLike,
    *,
    dark: ArrayLike | float = 0.0,
    origin: tuple[int, int] | None = None,
    workers: int | None = None,
) -> CameraCheck:
    """Compare ``camera`` with a white image and return the result.

    The lattice is fitted independently of the camera, so that a wrong description cannot bias it.

    Parameters
    ----------
    camera
        Camera description.
    white, dark
        White frame ``(rows, columns)``, and the dark frame or dark level to subtract.
    origin
        Sensor row and column of the first pixel, if the frames show only a part of the sensor. None: the frames show
        the whole sensor. Positions in the comparison are relative to the frames.
    workers
        Number of threads. None: one for each available CPU core.

    Raises
    ------
    InputError
        If the frame is not a white image, or with this ``origin`` extends beyond the sensor.
    """
    frame = np.asarray(white)
    if origin is not None and frame.ndim == 2:
        part, by_um = _part(camera, frame.shape, origin)
        found = check_camera(part, frame, dark=dark, workers=workers)
        if found.camera is None:
            return found
        whole = replace(found.camera, sensor=camera.sensor, lattice=_shifted(found.camera.periodic, by_um))
        return replace(found, camera=whole)
    lines = [_shape(camera, frame.shape)]
    if lines[0].verdict == WRONG:
        return CameraCheck(tuple(lines), None, None)
    rows, columns = frame.shape
    camera = replace(camera, sensor=replace(camera.sensor, shape=(rows, columns)))
    fit = fit_lattice(frame, dark=dark, workers=workers)
    lines.append(_kind(camera, fit))
    if lines[-1].verdict == WRONG:
        return CameraCheck(tuple(lines), fit, None)
    camera = _of_kind(camera, fit.kind)
    lines += [*_lengths(camera, fit), _rotation(camera, fit), _offset(camera, fit)]
    types = _types(frame, dark, fit, camera)
    if len(camera.lattice.types) == 3:
        lines.append(_type_order(camera, fit, types))
    lines += [*_distortion(camera, fit), _residual(fit)]
    return CameraCheck(tuple(lines), fit, _measured(camera, fit, types), types)


def _part(camera: Camera, shape: tuple[int, ...], origin: tuple[int, int]) -> tuple[Camera, tuple[float, float]]:
    """Return the camera of a part of the sensor, and the offset of its centre from that of the sensor (x, y; µm)."""
    sensor, lattice = camera.sensor, camera.periodic
    if any(o < 0 or o + n > size for o, n, size in zip(origin, shape, sensor.shape, strict=True)):
        raise InputError.expected(
            "white image",
            f"an image within the sensor of {sensor.shape[0]} x {sensor.shape[1]} px",
            f"{shape[0]} x {shape[1]} px at the origin {origin[0]},{origin[1]}",
            "correct the origin (the row comes first), or the camera's sensor",
        )
    x, y = camera.sensor_um([o + (n - 1) / 2 for o, n in zip(origin, shape, strict=True)]).tolist()
    # the part's description starts from a lenslet of type 0 within the part
    near = np.rint(lattice.lenslet_at((x, y))).astype(int)
    around = near + np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    zero = around[lattice.type_of(around[:, 0], around[:, 1]) == 0]
    first = zero[np.square((zero - near) @ lattice.basis_um()).sum(1).argmin()]
    offset = first @ lattice.basis_um() + np.array(lattice.offset_um)
    own = _shifted(replace(lattice, offset_um=(float(offset[0]), float(offset[1]))), (-x, -y))
    return replace(camera, sensor=replace(sensor, shape=(int(shape[0]), int(shape[1]))), lattice=own), (x, y)


def _shifted(lattice: LensletLattice, by_um: tuple[float, float]) -> LensletLattice:
    """Return the lattice relative to a centre displaced by ``-by_um`` (x, y)."""
    x, y = (a + b for a, b in zip(lattice.offset_um, by_um, strict=True))
    bent = lattice.distortion
    return replace(lattice, offset_um=(x, y), distortion=None if bent is None else bent.scaled(1.0, by_um))


def _judged(camera: Camera, path: str, edge_px: float, limit: float) -> str:
    if camera.marks[path] == "assumed":
        return UNKNOWN
    return FITS if edge_px <= FIT_PX else DIFFERS if edge_px <= limit else WRONG


def _reach(fit: LatticeFit) -> float:
    """Distance from the frame's centre to its corner (pixels)."""
    return math.hypot(*fit.shape) / 2


def _shape(camera: Camera, shape: tuple[int, ...]) -> CheckLine:
    if len(shape) != 2:
        raise InputError.expected("white image", "one frame (rows, columns)", f"the shape {shape}", "choose one frame")
    wanted = camera.sensor.shape
    same = FITS if tuple(shape) == wanted else UNKNOWN if camera.marks["sensor.shape"] == "assumed" else WRONG
    return CheckLine("sensor", f"{wanted[0]} x {wanted[1]} px", f"{shape[0]} x {shape[1]} px", None, same)


def _kind(camera: Camera, fit: LatticeFit) -> CheckLine:
    wanted = camera.lattice.kind
    verdict = FITS if wanted == fit.kind else UNKNOWN if camera.marks["lattice.kind"] == "assumed" else WRONG
    return CheckLine("array", wanted, fit.kind, None, verdict)


def _of_kind(camera: Camera, kind: str) -> Camera:
    """Return ``camera`` with the measured kind of array; a square one has one type."""
    lattice = camera.periodic
    if lattice.kind == kind:
        return camera
    return replace(camera, lattice=replace(lattice, kind=kind, types=lattice.types[:1], row_pitch_um=None))


def _lengths(camera: Camera, fit: LatticeFit) -> list[CheckLine]:
    """Compare pitch and row distance; their errors add up from the centre to the edge."""
    lattice, pixel = camera.lattice, camera.sensor.pixel_um
    pairs = (
        ("pitch", lattice.pitch_um / pixel, fit.pitch_px, "lattice.pitch_um"),
        ("distance of rows", lattice.row_step_um / pixel, fit.row_pitch_px, "lattice.pitch_um"),
    )
    found = []
    for label, expected, measured, path in pairs:
        edge = abs(measured - expected) / measured * _reach(fit)
        # with more than half a pitch at the edge, micro-images would be mistaken for their neighbours
        verdict = _judged(camera, path, edge, measured / 2)
        error = f" ± {fit.pitch_error_px:.4f}"
        found.append(CheckLine(label, f"{expected:.4f} px", f"{measured:.4f}{error} px", edge, verdict))
    return found


def _rotation(camera: Camera, fit: LatticeFit) -> CheckLine:
    """Compare the rotation; a lattice is unchanged by rotations of 60 or 90 degrees."""
    turn = math.pi / 3 if fit.kind == "hexagonal" else math.pi / 2
    expected = camera.lattice.rotation_rad
    apart = (fit.rotation_rad - expected + turn / 2) % turn - turn / 2
    edge = abs(apart) * _reach(fit)
    # a pitch error at only one end turns the lattice by this angle
    error = math.degrees(fit.pitch_error_px / fit.pitch_px)
    verdict = _judged(camera, "lattice.rotation_rad", edge, fit.pitch_px / 2)
    shown = f"{math.degrees(expected + apart):+.4f} ± {error:.4f}°"
    return CheckLine("rotation", f"{math.degrees(expected):+.4f}°", shown, edge, verdict)


def _offset(camera: Camera, fit: LatticeFit) -> CheckLine:
    """Compare the stated position of a micro-image with the nearest measured one."""
    row, column = camera.pixels(camera.lattice.offset_um)
    near = np.rint(fit.lenslet_at(row, column))
    place: NDArray[np.float64] = np.asarray(fit.centres_px(near[0], near[1]))
    apart = float(math.hypot(place[0] - row, place[1] - column))
    verdict = _judged(camera, "lattice.offset_um", apart, math.inf)
    error = fit.residual_rms_px / math.sqrt(max(1, len(fit.index)))
    shown = f"row {place[0]:.3f}, column {place[1]:.3f} ± {error:.3f}"
    return CheckLine("centre of a micro-image", f"row {row:.3f}, column {column:.3f}", shown, apart, verdict)


def _types(frame: NDArray[np.generic], dark: ArrayLike | float, fit: LatticeFit, camera: Camera) -> LensTypes | None:
    if len(camera.lattice.types) != 3:
        return None
    return classify_lens_types(frame, fit, expected_blur(camera), dark=dark)


def _type_order(camera: Camera, fit: LatticeFit, types: LensTypes | None) -> CheckLine:
    step = camera.lattice.type_step
    expected = f"0, and {step} to its right"
    if types is None:
        return CheckLine("lens type at the offset", expected, "not distinguishable", None, UNKNOWN)
    row, column = camera.pixels(camera.lattice.offset_um)
    q, r = np.rint(fit.lenslet_at(row, column)).astype(int)
    kind = int(types.type_of(q, r))
    shown = f"{kind}, and {types.type_step} to the right of 0 ({types.sigmas:.0f} σ)"
    same = kind == 0 and types.type_step == step
    certain = types.sigmas >= 5
    # the types at an assumed position are unknown; a small difference proves nothing
    unknown = camera.marks["lattice.offset_um"] == "assumed" or not certain
    return CheckLine(
        "lens type at the offset", expected, shown, None, FITS if same else UNKNOWN if unknown else DIFFERS
    )


def _distortion(camera: Camera, fit: LatticeFit) -> list[CheckLine]:
    """Compare the largest displacement from straight rows, if there is any."""
    described, found = camera.lattice.distortion, fit.distortion
    if described is None and found is None:
        return []
    sizes = [0.0 if d is None else float(d.largest) for d in (described, found)]
    sizes[0] /= camera.sensor.pixel_um
    shown = [
        "none" if d is None else f"{d.model}, up to {size:.2f} px"
        for d, size in zip((described, found), sizes, strict=True)
    ]
    edge = abs(sizes[1] - sizes[0])
    return [CheckLine("distortion", shown[0], shown[1], edge, FITS if edge <= FIT_PX else DIFFERS)]


def _residual(fit: LatticeFit) -> CheckLine:
    rms = fit.residual_rms_px
    verdict = FITS if rms <= FIT_PX else DIFFERS
    return CheckLine("distance from the lattice", f"below {FIT_PX:g} px rms", f"{rms:.3f} px rms", rms, verdict)


def _measured(camera: Camera, fit: LatticeFit, types: LensTypes | None) -> Camera:
    lattice = fit.to_lattice(camera) if types is None else types.to_lattice(fit, camera)
    names = {field.name for field in fields(lattice)} & {*MEASURED, *(("type_step",) if types is not None else ())}
    marks = camera.marks.marked([f"lattice.{name}" for name in names if getattr(lattice, name) is not None], "measured")
    if marks["sensor.shape"] == "assumed":
        marks = marks.marked(["sensor.shape"], "measured")
    if marks["lattice.kind"] == "assumed":
        marks = marks.marked(["lattice.kind"], "measured")
    return replace(camera, lattice=lattice, marks=marks)
