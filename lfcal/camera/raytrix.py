"""Raytrix calibration XML as a camera."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from lfcal.camera.description import Camera
from lfcal.camera.distortion import BrownDistortion
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Optics
from lfcal.camera.sensor import Sensor
from lfcal.errors import FileFormatError, InputError, UnsafeFileError
from lfcal.files import check_regular, storage_errors

__all__ = ["read_raytrix_xml"]

ROOT = "RayCalibData"
MAX_BYTES = 1 << 20
"""Real files have 1.4 kB."""

FLIP_Y = np.array([1.0, -1.0])
"""The file counts y upwards; images count it downwards."""


def read_raytrix_xml(
    path: str | os.PathLike[str],
    *,
    sensor: Sensor | None = None,
    optics: Optics | None = None,
    gap_um: float | None = None,
    focus_depths: Sequence[float] | None = None,
    name: str | None = None,
) -> Camera:
    """Return the camera of a Raytrix calibration file (``RayCalibData``).

    The file holds the lattice (pitch, rotation, offset from the image centre with y up, lens bases, sub-grid),
    the lens types with their depth ranges, and the distortion. The lattice comes out with a small rotation
    and with the file's numbers of the lens types. What the file does not hold is taken from the arguments.

    Parameters
    ----------
    path
        The XML file, UTF-8 or UTF-16, at most 1 MB.
    sensor
        Image sensor; by default that of the R29, 4384 x 6576 pixels of 5.5 µm.
    optics
        Main lens; by default 200 mm, f/4, focused at 1 m.
    gap_um
        Distance from lenslets to sensor (µm); by default the pitch times the main lens's working f-number,
        at which micro-images just touch.
    focus_depths
        Virtual depth that each type has in focus; by default the one that blurs both ends of the type's
        depth range alike, ``1/v = (1/near + 1/far) / 2``.
    name
        Name of the camera; by default that of the file.

    Raises
    ------
    FileFormatError
        If the file is not such a calibration, or an entry is missing or is not a number.
    UnsafeFileError
        If the file declares entities or a document type, or is too large.
    StorageError
        If the file cannot be read.
    """
    source = Path(path)
    root = _parse(source)
    sensor = Sensor() if sensor is None else sensor
    optics = MainLens() if optics is None else optics
    diameter = _number(root, "diameter", "pix", source)
    if not diameter > 0:
        raise FileFormatError.expected(f"{source}: diameter", "a number > 0", diameter, "export the file again")
    pitch_um = diameter * sensor.pixel_um
    gap_um = pitch_um * optics.working_f_number if gap_um is None else gap_um
    border = _number(root, "lens_border", "pix", source)
    offsets, ranges = _lens_types(root, source)
    types = _focused(ranges, focus_depths, gap_um, source)
    rotation, offset, step = _placement(root, diameter, offsets, source)
    try:
        lattice = LensletLattice(
            "hexagonal",
            pitch_um,
            gap_um,
            types,
            rotation,
            (offset[0] * sensor.pixel_um, offset[1] * sensor.pixel_um),
            # the border is dark on both sides of a micro-image
            (diameter - 2 * border) * sensor.pixel_um,
            type_step=step,
        )
        return Camera(name or source.stem, optics, lattice, sensor, distortion=_distortion(root, source))
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None


def _parse(source: Path) -> ElementTree.Element:
    check_regular(source)
    with storage_errors(source), source.open("rb") as file:
        # one byte more than allowed shows that the file is too large, without reading all of it
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise UnsafeFileError.expected(str(source), "at most 1 MB of XML", "more", "choose the calibration file")
    utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        text = data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        raise FileFormatError.expected(
            str(source), "XML text in UTF-8 or UTF-16", "other bytes", "choose the calibration file"
        ) from None
    # entities can expand without bound or read other files (XXE); calibrations contain none
    for mark in ("<!DOCTYPE", "<!ENTITY"):
        if mark in text.upper():
            raise UnsafeFileError.expected(
                str(source), "XML without a document type", mark, "remove it; calibrations have none"
            )
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise FileFormatError.expected(str(source), "XML", str(error), "export the file again") from None
    if root.tag != ROOT:
        raise FileFormatError.expected(
            str(source), f"<{ROOT}>", f"<{root.tag[:40]}>", "choose a Raytrix calibration file"
        )
    return root


def _only(parent: ElementTree.Element, tag: str, source: Path) -> ElementTree.Element:
    found = parent.findall(tag)
    if len(found) != 1:
        raise FileFormatError.expected(
            f"{source}: <{tag}> in <{parent.tag}>", "one", len(found), "export the file again"
        )
    return found[0]


def _number(parent: ElementTree.Element, tag: str, units: str | None, source: Path) -> float:
    entry = _only(parent, tag, source)
    if units is not None:
        _check_units(entry, units, source)
    return _float(entry.text, f"{source}: <{tag}>")


def _float(text: str | None, what: str) -> float:
    try:
        value = float((text or "").strip())
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        got = repr((text or "").strip()[:40])
        raise FileFormatError.expected(what, "a number", got, "export the file again")
    return value


def _check_units(entry: ElementTree.Element, units: str, source: Path) -> None:
    if entry.get("units", units) != units:
        raise FileFormatError.expected(
            f"{source}: <{entry.tag}>", f'units "{units}"', repr(entry.get("units")), "export it again"
        )


def _pair(parent: ElementTree.Element, tag: str, units: str, source: Path) -> NDArray[np.float64]:
    entry = _only(parent, tag, source)
    _check_units(entry, units, source)
    return np.array([_number(entry, axis, None, source) for axis in ("x", "y")])


def _lens_types(root: ElementTree.Element, source: Path) -> tuple[NDArray[np.float64], tuple[tuple[float, float], ...]]:
    """Return the types' offsets ``(n, 2)`` (lens diameters, y up) and depth ranges, by the file's ids."""
    found = {entry.get("id", ""): entry for entry in root.findall("lens_type")}
    names = [str(k) for k in range(len(found))]
    if len(found) not in (1, 3) or sorted(found) != names or len(root.findall("lens_type")) != len(found):
        got = ", ".join(sorted(found)) or "none"
        raise FileFormatError.expected(f"{source}: lens types", "ids 0, or 0, 1 and 2", got, "export it again")
    offsets = np.array([_pair(found[k], "offset", "lens", source) for k in names])
    ranges = []
    for k in names:
        entry = _only(found[k], "depth_range", source)
        _check_units(entry, "virtual_depth", source)
        ranges.append((_number(entry, "min", None, source), _number(entry, "max", None, source)))
    return offsets, tuple(ranges)


def _focused(
    ranges: tuple[tuple[float, float], ...], focus: Sequence[float] | None, gap_um: float, source: Path
) -> tuple[LensType, ...]:
    if focus is None:
        for near, far in ranges:
            # v = 1 is the sensor itself; an image between lenslets and sensor cannot be refocused
            if not 1 <= near < far:
                raise FileFormatError.expected(
                    f"{source}: depth range", "1 ≤ min < max", f"{near:g} to {far:g}", "export it again"
                )
        # equal blur at both ends: the blur is proportional to |1/v - 1/v_focus|
        focus = [2.0 / (1.0 / near + 1.0 / far) for near, far in ranges]
    if len(focus) != len(ranges):
        raise InputError.expected("focus depths", f"{len(ranges)}, one per lens type", len(focus), "correct them")
    return tuple(LensType.focused_at(v, gap_um, pair) for v, pair in zip(focus, ranges, strict=True))


def _placement(
    root: ElementTree.Element, diameter: float, offsets: NDArray[np.float64], source: Path
) -> tuple[float, tuple[float, float], int]:
    """Return rotation (rad), offset (x, y) (px, y down) of a type-0 lens, and the step of types along a row."""
    # unit vectors at 60 or 120 degrees
    base = np.array([_pair(root, f"lens_base_{axis}", "lens", source) for axis in "xy"])
    if abs(np.linalg.norm(base, axis=1) - 1).max() > 0.01 or abs(abs(base[0] @ base[1]) - 0.5) > 0.01:
        got = f"{base.round(3).tolist()}"
        raise FileFormatError.expected(f"{source}: lens bases", "a hexagonal lattice", got, "export it again")
    _check_sub_grid(_pair(root, "sub_grid_base", "lens", source), len(offsets), source)
    # y up to y down turns a counter-clockwise angle into one from +x towards +y of the opposite sign
    turn = -_number(root, "rotation", "rad", source)
    row = _row_angle(math.atan2(-base[0, 1], base[0, 0]) + turn)
    c, s = math.cos(turn), math.sin(turn)
    centres = _pair(root, "offset", "pix", source) * FLIP_Y + (
        diameter * (offsets * FLIP_Y) @ np.array([[c, s], [-s, c]])
    )
    step = 1
    if len(offsets) == 3:
        # type 0 must lie at the origin of the indices, and the others where LensletLattice colours its neighbours
        lattice = LensletLattice("hexagonal", diameter, 1.0, (LensType(1.0),) * 3, row, tuple(centres[0]))
        index = (centres - centres[0]) @ np.linalg.inv(lattice.basis_um())
        whole = np.rint(index).astype(int)
        found = lattice.type_of(whole[:, 0], whole[:, 1])
        if abs(index - whole).max() > 0.05 or len(set(found.tolist())) != 3:
            got = offsets.round(3).tolist()
            raise FileFormatError.expected(
                f"{source}: lens type offsets", "neighbours of three types", got, "export it again"
            )
        step = 1 if found[1] == 1 else 2
    return row, (float(centres[0, 0]), float(centres[0, 1])), step


def _row_angle(angle: float) -> float:
    """Return the angle, of those 60 degrees apart, that lies nearest a sensor axis (rad, in [0, 90] or so)."""
    sixth, quarter = math.pi / 3, math.pi / 2
    # a hexagonal lattice looks the same every 60 degrees; the rounding makes ties between equal angles repeatable
    candidates = [angle + k * sixth for k in range(-6, 7)]
    return min(candidates, key=lambda a: (round(abs(a - quarter * round(a / quarter)), 9), round(abs(a), 9)))


def _check_sub_grid(vector: NDArray[np.float64], types: int, source: Path) -> None:
    """Raise unless the sub-grid is the rectangular cell that the lattice implies: (3, √3) lenses for three types."""
    wanted = (3.0 if types == 3 else 1.0, math.sqrt(3))
    if np.abs(np.abs(vector) - wanted).max() > 0.01:
        got = np.abs(vector).round(4).tolist()
        raise FileFormatError.expected(
            f"{source}: sub-grid base", f"({wanted[0]:g}, {wanted[1]:.4f}) lenses", got, "export it again"
        )


def _distortion(root: ElementTree.Element, source: Path) -> BrownDistortion | None:
    if root.find("distortion") is None:
        return None
    entry = _only(root, "distortion", source)
    function = (_only(entry, "function", source).text or "").strip()
    if function not in ("Brown", "constant"):
        raise FileFormatError.expected(
            f"{source}: distortion", "the function Brown or constant", repr(function), "export it without distortion"
        )
    text = (entry.findtext("parameter") or "").strip()
    values = tuple(_float(part, f"{source}: distortion parameter") for part in text.split(";") if text)
    if function == "constant":  # the maker's word for none
        if any(values):
            raise FileFormatError.expected(
                f"{source}: constant distortion", "no parameters", text[:60], "export it without distortion"
            )
        return None
    if not values:
        raise FileFormatError.expected(f"{source}: distortion", "parameters", "none", "export it without distortion")
    centre = _pair(entry, "offset", "pix", source)
    return BrownDistortion(values, (float(centre[0]), float(centre[1])))
