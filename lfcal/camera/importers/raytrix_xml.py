"""Reader for the calibration file of a Raytrix camera (``RayCalibData``)."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, UnsafeFileError
from lfcal.camera.description import Camera
from lfcal.camera.distortion import BrownDistortion
from lfcal.camera.draft import Draft
from lfcal.camera.importers.camera_format import CameraFormat, Imported, ImportOptions, file_text
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import Optics
from lfcal.camera.sensor import Sensor

__all__ = ["FORMAT", "entry_of", "float_of", "lens_types", "number_of", "pair_of", "placement", "read_raytrix_xml"]

ROOT = "RayCalibData"
MAX_BYTES = 1 << 20
"""Largest size of a file (characters); real files have 1.4 kB."""

NOT_APPLIED = (
    "the manufacturer's distortion (Brown) is stored but not applied, because the file states "
    "neither the coordinates to which it applies nor the unit of its radius; a white image gives the "
    "distortion of the lattice"
)


def read_raytrix_xml(
    path: str | os.PathLike[str],
    *,
    sensor: Sensor | None = None,
    optics: Optics | None = None,
    gap_um: float | None = None,
    focus_depths: Sequence[float] | None = None,
    name: str | None = None,
) -> Camera:
    """Return the camera described by a Raytrix calibration file (``RayCalibData``).

    The file contains the lattice (pitch, rotation, offset from the image centre with y up, lens bases, sub-grid), the
    lens types with their depth ranges, and the distortion. The rows of the returned lattice are as close as possible to
    a sensor axis, and its lens types are numbered as in the file. Values that are not in the file are taken from the
    parameters. Values that neither contains are assumed and marked as such.

    Parameters
    ----------
    path
        Path of the XML file, which must be UTF-8 or UTF-16 text of at most 1 MB.
    sensor
        Image sensor. None: that of the R29, with 4384 x 6576 pixels of 5.5 µm.
    optics
        Main lens or microscope. None: a 200 mm f/4 lens focused at 1 m.
    gap_um
        Distance from the lenslets to the sensor (µm). None: the pitch times the working f-number of the optics, at
        which adjacent micro-images just touch.
    focus_depths
        Virtual depth v at which each lens type is in focus. None: the one with equal blur at both ends of the depth
        range of the type, ``1/v = (1/near + 1/far) / 2``.
    name
        Display name of the camera. None: the name of the file.

    Raises
    ------
    FileFormatError
        If the file is not such a calibration file, an entry is missing or is not a number, or a camera cannot have
        these values.
    InputError
        If the number of ``focus_depths`` is not that of the lens types.
    UnsafeFileError
        If the file declares entities or a document type, or is too large.
    StorageError
        If the file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import read_raytrix_xml
    >>> vectors = [("offset", 22, 9), ("lens_base_x", 1, 0), ("lens_base_y", 0.5, 0.866), ("sub_grid_base", 3, 1.732)]
    >>> text = "".join(f"<{name}><x>{x}</x><y>{y}</y></{name}>" for name, x, y in vectors)
    >>> text += "<diameter>32</diameter><rotation>0</rotation><lens_border>1</lens_border>"
    >>> for k, x in enumerate((0, 1, 2)):
    ...     text += f"<lens_type id='{k}'><offset><x>{x}</x><y>0</y></offset>"
    ...     text += f"<depth_range><min>{k + 1}</min><max>{k + 3}</max></depth_range></lens_type>"
    >>> _ = Path("calibration.xml").write_text(f"<RayCalibData>{text}</RayCalibData>")
    >>> camera = read_raytrix_xml("calibration.xml")
    >>> print(camera.pitch_px, [round(kind.focus_depth(camera.lattice.gap_um), 2) for kind in camera.lattice.types])
    32.0 [1.5, 2.67, 3.75]
    """
    values: dict[str, Any] = {}
    for part, held in (("optics", optics), ("sensor", sensor)):
        if held is not None:
            values |= {f"{part}.{field.name}": getattr(held, field.name) for field in fields(held)}
    if gap_um is not None:
        values["lattice.gap_um"] = gap_um
    if focus_depths is not None:
        values["lattice.focus"] = tuple(focus_depths)
    source = Path(path)
    draft = _draft(_root(file_text(source), source), values, source)
    return _camera(draft, name or source.stem, source)


def _read(text: str, source: Path, options: ImportOptions) -> Imported:
    draft = _draft(_root(text, source), options.values, source)
    return Imported(_camera(draft, source.stem, source), (NOT_APPLIED,) if draft.distortion is not None else ())


def _camera(draft: Draft, name: str, source: Path) -> Camera:
    try:
        return draft.camera(name)
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None


def _draft(root: ElementTree.Element, values: Mapping[str, Any], source: Path) -> Draft:
    draft = Draft("Microscope" if "optics.magnification" in values else "MainLens", values)
    diameter = number_of(root, "diameter", "pix", source)
    if not diameter > 0:
        raise FileFormatError.expected(f"{source}: diameter", "a number > 0", diameter, "export the file again")
    border = number_of(root, "lens_border", "pix", source)
    offsets, ranges = lens_types(root, source)
    _check_types(ranges, values, source)
    rotation, offset, step = placement(root, diameter, offsets, source)
    pixel = draft.get("sensor.pixel_um")
    draft.put("lattice.kind", "hexagonal")
    draft.put("lattice.rotation_rad", rotation)
    # the file counts in pixels: these lengths are no more reliable than the pixel pitch
    draft.put("lattice.pitch_um", diameter * pixel, "derived")
    draft.put("lattice.offset_um", (offset[0] * pixel, offset[1] * pixel), "derived")
    # the border is dark on both sides of a micro-image
    draft.put("lattice.clear_um", (diameter - 2 * border) * pixel, "derived")
    draft.put("lattice.type_step", step, "derived")
    draft.put("lattice.depth_ranges", ranges)
    draft.distortion = _distortion(root, source)
    return draft


def _check_types(ranges: tuple[tuple[float, float], ...], values: Mapping[str, Any], source: Path) -> None:
    for near, far in ranges:
        # v = 1 is the sensor itself; an image between lenslets and sensor cannot be refocused
        if not 1 <= near < far and "lattice.focus" not in values:
            raise FileFormatError.expected(
                f"{source}: depth range", "1 ≤ min < max", f"{near:g} to {far:g}", "export the file again"
            )
    focus = values.get("lattice.focus", ranges)
    if len(focus) != len(ranges):
        raise InputError.expected(
            "focus depths", f"{len(ranges)}, one per lens type", len(focus), "state the focus depth of each lens type"
        )


def _root(text: str, source: Path) -> ElementTree.Element:
    if len(text) > MAX_BYTES:
        raise UnsafeFileError.expected(
            str(source), "at most 1 MB of XML", "a larger file", "choose the calibration file"
        )
    # entities can expand without bound or read other files (XXE); calibrations contain none
    for mark in ("<!DOCTYPE", "<!ENTITY"):
        if mark in text.upper():
            raise UnsafeFileError.expected(
                str(source), "XML without a document type", mark, "remove it; calibration files have none"
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


def _distortion(root: ElementTree.Element, source: Path) -> BrownDistortion | None:
    if root.find("distortion") is None:
        return None
    entry = entry_of(root, "distortion", source)
    function = (entry_of(entry, "function", source).text or "").strip()
    if function not in ("Brown", "constant"):
        raise FileFormatError.expected(
            f"{source}: distortion",
            "the function Brown or constant",
            repr(function),
            "export the file without distortion",
        )
    text = (entry.findtext("parameter") or "").strip()
    values = tuple(float_of(part, f"{source}: distortion parameter") for part in text.split(";") if text)
    if function == "constant":  # the manufacturer's word for none
        if any(values):
            raise FileFormatError.expected(
                f"{source}: constant distortion", "no parameters", text[:60], "export the file without distortion"
            )
        return None
    if not values:
        raise FileFormatError.expected(
            f"{source}: distortion", "parameters", "none", "export the file without distortion"
        )
    centre = pair_of(entry, "offset", "pix", source)
    return BrownDistortion(values, (float(centre[0]), float(centre[1])))


FORMAT = CameraFormat("Raytrix XML", (".xml",), lambda head: head[:1] == "<", _read)


FLIP_Y = np.array([1.0, -1.0])
"""Sign that converts the file's y (up) to image rows (down)."""


def entry_of(parent: ElementTree.Element, tag: str, source: Path) -> ElementTree.Element:
    """Return the child element ``tag`` of ``parent``; raise `FileFormatError` unless there is exactly one.

    ``source`` is the file, for the message.
    """
    found = parent.findall(tag)
    if len(found) != 1:
        raise FileFormatError.expected(
            f"{source}: <{tag}> in <{parent.tag}>", "one", len(found), "export the file again"
        )
    return found[0]


def number_of(parent: ElementTree.Element, tag: str, units: str | None, source: Path) -> float:
    """Return the number in the child element ``tag`` of ``parent``, in the file ``source``.

    Raise `FileFormatError` unless there is exactly one such element, with a finite number. If it states units, they
    must be ``units`` (None: any).
    """
    entry = entry_of(parent, tag, source)
    if units is not None:
        _check_units(entry, units, source)
    return float_of(entry.text, f"{source}: <{tag}>")


def float_of(text: str | None, what: str) -> float:
    """Return ``text`` as a finite number, or raise `FileFormatError`, which names ``what``."""
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
            f"{source}: <{entry.tag}>", f'units "{units}"', repr(entry.get("units")), "export the file again"
        )


def pair_of(parent: ElementTree.Element, tag: str, units: str, source: Path) -> NDArray[np.float64]:
    """Return the vector (x, y) in the child element ``tag`` of ``parent``, in the file ``source``.

    Raise `FileFormatError` unless there is exactly one such element, with a finite number for each axis. If it states
    units, they must be ``units``.
    """
    entry = entry_of(parent, tag, source)
    _check_units(entry, units, source)
    return np.array([number_of(entry, axis, None, source) for axis in ("x", "y")])


def lens_types(root: ElementTree.Element, source: Path) -> tuple[NDArray[np.float64], tuple[tuple[float, float], ...]]:
    """Return the offsets (x, y) of the lens types, ``(n, 2)``, and their depth ranges (near, far), in the order of ids.

    Offsets are in lens diameters with y up, and depth ranges are virtual depths. Raise `FileFormatError` unless there
    are one or three types with ids from 0.
    """
    found = {entry.get("id", ""): entry for entry in root.findall("lens_type")}
    names = [str(k) for k in range(len(found))]
    if len(found) not in (1, 3) or sorted(found) != names or len(root.findall("lens_type")) != len(found):
        got = ", ".join(sorted(found)) or "none"
        raise FileFormatError.expected(f"{source}: lens types", "ids 0, or 0, 1 and 2", got, "export the file again")
    offsets = np.array([pair_of(found[k], "offset", "lens", source) for k in names])
    ranges = []
    for k in names:
        entry = entry_of(found[k], "depth_range", source)
        _check_units(entry, "virtual_depth", source)
        ranges.append((number_of(entry, "min", None, source), number_of(entry, "max", None, source)))
    return offsets, tuple(ranges)


def placement(
    root: ElementTree.Element, diameter: float, offsets: NDArray[np.float64], source: Path
) -> tuple[float, tuple[float, float], int]:
    """Return the rotation, the offset and the step of types of the lattice that the XML element ``root`` describes.

    These are `LensletLattice.rotation_rad`, the offset (x, y) of a type-0 micro-image from the image centre (px, y
    down), and `LensletLattice.type_step`. ``diameter`` is the distance between micro-images (px), and ``offsets`` are
    those of `lens_types`. Raise `FileFormatError` unless the lattice is hexagonal with one lens of each type among
    three neighbours.
    """
    # unit vectors at 60 or 120 degrees
    base = np.array([pair_of(root, f"lens_base_{axis}", "lens", source) for axis in "xy"])
    if abs(np.linalg.norm(base, axis=1) - 1).max() > 0.01 or abs(abs(base[0] @ base[1]) - 0.5) > 0.01:
        got = f"{base.round(3).tolist()}"
        raise FileFormatError.expected(f"{source}: lens bases", "a hexagonal lattice", got, "export the file again")
    _check_sub_grid(pair_of(root, "sub_grid_base", "lens", source), len(offsets), source)
    # y up to y down turns a counter-clockwise angle into one from +x towards +y of the opposite sign
    turn = -number_of(root, "rotation", "rad", source)
    row = _row_angle(math.atan2(-base[0, 1], base[0, 0]) + turn)
    c, s = math.cos(turn), math.sin(turn)
    centres = pair_of(root, "offset", "pix", source) * FLIP_Y + (
        diameter * (offsets * FLIP_Y) @ np.array([[c, s], [-s, c]])
    )
    step = 1
    if len(offsets) == 3:
        # type 0 must be at the origin of the indices, and the others where LensletLattice assigns them
        lattice = LensletLattice("hexagonal", diameter, 1.0, (LensType(1.0),) * 3, row, tuple(centres[0]))
        index = (centres - centres[0]) @ np.linalg.inv(lattice.basis_um())
        whole = np.rint(index).astype(int)
        found = lattice.type_of(whole[:, 0], whole[:, 1])
        if abs(index - whole).max() > 0.05 or len(set(found.tolist())) != 3:
            got = offsets.round(3).tolist()
            raise FileFormatError.expected(
                f"{source}: lens type offsets",
                "those of three neighbouring lenslets, one of each type",
                got,
                "export the file again",
            )
        step = 1 if found[1] == 1 else 2
    return row, (float(centres[0, 0]), float(centres[0, 1])), step


def _row_angle(angle: float) -> float:
    """Return the angle closest to a sensor axis among ``angle`` and those at multiples of 60 degrees from it (rad)."""
    sixth, quarter = math.pi / 3, math.pi / 2
    # a hexagonal lattice looks the same every 60 degrees; the rounding makes ties reproducible
    candidates = [angle + k * sixth for k in range(-6, 7)]
    return min(candidates, key=lambda a: (round(abs(a - quarter * round(a / quarter)), 9), round(abs(a), 9)))


def _check_sub_grid(vector: NDArray[np.float64], types: int, source: Path) -> None:
    """Raise `FileFormatError` unless the sub-grid is the lattice's rectangular cell, (3, √3) for three types."""
    wanted = (3.0 if types == 3 else 1.0, math.sqrt(3))
    if np.abs(np.abs(vector) - wanted).max() > 0.01:
        got = "({:.4g}, {:.4f}) lenses".format(*np.abs(vector).tolist())
        raise FileFormatError.expected(
            f"{source}: sub-grid base", f"({wanted[0]:g}, {wanted[1]:.4f}) lenses", got, "export the file again"
        )
