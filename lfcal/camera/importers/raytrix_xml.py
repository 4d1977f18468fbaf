"""The calibration file of a Raytrix camera (``RayCalibData``) as a camera."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from lfcal.base import FileFormatError, InputError, UnsafeFileError
from lfcal.camera.description import Camera
from lfcal.camera.distortion import BrownDistortion
from lfcal.camera.draft import Draft
from lfcal.camera.importers._raytrix_grid import entry_of, float_of, lens_types, number_of, pair_of, placement
from lfcal.camera.importers.camera_format import CameraFormat, Imported, Wanted, file_text
from lfcal.camera.main_lens import Optics
from lfcal.camera.sensor import Sensor

__all__ = ["FORMAT", "read_raytrix_xml"]

ROOT = "RayCalibData"
MAX_BYTES = 1 << 20
"""Real files have 1.4 kB."""

NOT_APPLIED = (
    "the maker's distortion (Brown) is kept and not applied: the file says neither what it acts on nor in which unit "
    "its radius is; a white image gives the lattice's own distortion"
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
    """Return the camera of a Raytrix calibration file (``RayCalibData``).

    The file holds the lattice (pitch, rotation, offset from the image centre with y up, lens bases, sub-grid),
    the lens types with their depth ranges, and the distortion. The lattice comes out with a small rotation
    and with the file's numbers of the lens types. What the file does not hold is taken from the arguments, and
    marked as assumed where they do not give it either.

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


def _read(text: str, source: Path, wanted: Wanted) -> Imported:
    draft = _draft(_root(text, source), wanted.values, source)
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
    # the file counts in pixels: these lengths are no better known than the pixel is
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
                f"{source}: depth range", "1 ≤ min < max", f"{near:g} to {far:g}", "export it again"
            )
    focus = values.get("lattice.focus", ranges)
    if len(focus) != len(ranges):
        raise InputError.expected("focus depths", f"{len(ranges)}, one per lens type", len(focus), "correct them")


def _root(text: str, source: Path) -> ElementTree.Element:
    if len(text) > MAX_BYTES:
        raise UnsafeFileError.expected(str(source), "at most 1 MB of XML", "more", "choose the calibration file")
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


def _distortion(root: ElementTree.Element, source: Path) -> BrownDistortion | None:
    if root.find("distortion") is None:
        return None
    entry = entry_of(root, "distortion", source)
    function = (entry_of(entry, "function", source).text or "").strip()
    if function not in ("Brown", "constant"):
        raise FileFormatError.expected(
            f"{source}: distortion", "the function Brown or constant", repr(function), "export it without distortion"
        )
    text = (entry.findtext("parameter") or "").strip()
    values = tuple(float_of(part, f"{source}: distortion parameter") for part in text.split(";") if text)
    if function == "constant":  # the maker's word for none
        if any(values):
            raise FileFormatError.expected(
                f"{source}: constant distortion", "no parameters", text[:60], "export it without distortion"
            )
        return None
    if not values:
        raise FileFormatError.expected(f"{source}: distortion", "parameters", "none", "export it without distortion")
    centre = pair_of(entry, "offset", "pix", source)
    return BrownDistortion(values, (float(centre[0]), float(centre[1])))


FORMAT = CameraFormat("Raytrix XML", (".xml",), lambda head: head[:1] == "<", _read)
