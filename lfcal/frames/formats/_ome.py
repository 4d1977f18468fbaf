"""OME metadata of TIFF files: order of the pages, stage coordinates, exposures, pixel size."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any
from xml.etree import ElementTree

import numpy as np

from lfcal.frames.part import parse_roi

__all__ = ["ome_facts"]

LENGTHS = {"µm": 1.0, "μm": 1.0, "um": 1.0, "mm": 1e3, "nm": 1e-3, "m": 1e6, "cm": 1e4, "reference frame": 1.0}
"""Micrometres in OME's units; positions default to a reference frame without a unit, in practice µm."""
TIMES = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "μs": 1e-6, "min": 60.0}
MAX_CHARACTERS = 1 << 26
MAX_PLANES = 10_000_000

Page = tuple[str, int]
"""Name of a file, empty for the file that is being read, and page number."""


def ome_facts(text: str, pages: int, *, name: str = "", samples: int = 1) -> dict[str, Any]:
    """Return the facts that OME-XML ``text`` states about the planes in a file of ``pages`` pages.

    ``TiffData`` (IFD, FirstZ, FirstC, FirstT, PlaneCount, UUID of the file) assigns planes to pages. The pages of an
    image without ``TiffData`` follow each other in ``DimensionOrder``. Missing and unreadable facts are left out,
    because the images can be used without them.

    Parameters
    ----------
    text
        The XML text.
    pages
        Number of pages of the file that contains it.
    name
        Name of the file.
    samples
        Samples per pixel, which is the number of OME channels that share a page.

    Returns
    -------
    dict
        ``stage_um`` ``(n, 3)`` as (x, y, z), NaN for an axis that is not stated; ``stage_pages``, the corresponding n
        pages (file, page); ``stage_exposure_s`` ``(n,)``; ``exposure_s`` ``(pages,)`` in the order of the file;
        ``page_order``, the pages in the order of the planes, slowest axis first; ``scan_axes``, names and lengths of
        these axes; ``order_notes``; ``pixel_um``; ``roi``, the region of the camera (column, row, width, height).
    """
    # entities can turn a small XML file into a large one; OME does not use them
    if len(text) > MAX_CHARACTERS or re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        return {}
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError):
        return {}
    images = root.findall("{*}Image/{*}Pixels")
    facts: dict[str, Any] = {}
    if images and (size := _value(images[0], "PhysicalSizeX", LENGTHS, "µm")) is not None and size > 0:
        facts["pixel_um"] = size
    if (roi := _roi(root)) is not None:
        facts["roi"] = roi
    try:
        planes = [_planes(pixels, samples) for pixels in images]
        _place(planes, images, _Files(root, images, name, pages))
        modulo = _modulo(root)
    except (ValueError, OverflowError) as error:
        if root.find("{*}Image/{*}Pixels/{*}TiffData") is not None:
            facts["order_notes"] = (
                f"pages: the OME metadata are invalid ({error}); pages are read in the order of the file",
            )
        return facts
    order = _of_pages(planes, pages) | _of_order(planes, pages, modulo)
    notes = _order_notes(planes, pages) if order else ()
    return facts | order | ({"order_notes": notes} if notes else {})


@dataclass(slots=True)
class _Planes:
    """The planes of an image in ``DimensionOrder``: axes and lengths, fastest first; element and page by plane."""

    axes: str
    lengths: tuple[int, ...]
    elements: dict[int, ElementTree.Element] = field(default_factory=dict)
    pages: dict[int, Page] = field(default_factory=dict)

    @property
    def count(self) -> int:
        return int(np.prod(self.lengths))

    def number(self, element: ElementTree.Element, prefix: str) -> int:
        """Return the number of the plane whose Z, C and T an element states with ``prefix``; missing ones are 0."""
        at = [int(element.get(f"{prefix}{axis}", "0")) for axis in self.axes]
        if any(not 0 <= k < n for k, n in zip(at, self.lengths, strict=True)):
            raise ValueError("a plane outside the image")
        return int(np.ravel_multi_index(at, self.lengths, order="F"))


def _planes(pixels: ElementTree.Element, samples: int) -> _Planes:
    """Return the planes of an image with their elements; raise `ValueError` for impossible image sizes."""
    axes = pixels.get("DimensionOrder", "XYCZT")[2:]
    if sorted(axes) != ["C", "T", "Z"]:
        raise ValueError("unknown order of dimensions")
    found = pixels.findall("{*}Plane")
    lengths = []
    for axis in axes:
        # sizes are required; if a writer omitted them, the planes define them
        most = 1 + max((int(plane.get(f"The{axis}", "0")) for plane in found), default=0)
        size = int(pixels.get(f"Size{axis}", most))
        lengths.append(size // samples if axis == "C" and samples > 1 and size % samples == 0 else size)
    planes = _Planes(axes, tuple(lengths))
    if min(lengths) < 1 or np.prod(lengths, dtype=object) > MAX_PLANES:
        raise ValueError("impossible image sizes")
    for plane in found:
        planes.elements[planes.number(plane, "The")] = plane
    return planes


class _Files:
    """Names of the files to which ``TiffData`` elements refer by UUID or name."""

    def __init__(self, root: ElementTree.Element, images: list[ElementTree.Element], name: str, pages: int) -> None:
        self.pages = pages
        marks = [mark for pixels in images for mark in pixels.findall("{*}TiffData/{*}UUID")]
        uuids = {_uuid(mark) for mark in marks}
        own = root.get("UUID", "").strip().lower()
        if own not in uuids:
            named = {_uuid(mark) for mark in marks if name and mark.get("FileName") == name}
            # a renamed file is still the only possible one
            own = next(iter(named or (uuids if len(uuids) == 1 else ())), "")
        self._own = own

    def of(self, data: ElementTree.Element) -> str:
        """Return the name of the file, empty for the one that is being read."""
        mark = data.find("{*}UUID")
        if mark is None or (self._own and _uuid(mark) == self._own):
            return ""
        return mark.get("FileName") or _uuid(mark)


def _uuid(mark: ElementTree.Element) -> str:
    return (mark.text or "").strip().lower()


def _place(planes: list[_Planes], images: list[ElementTree.Element], files: _Files) -> None:
    """Assign a page to every plane; raise `ValueError` if two planes get one page, or one plane gets two pages."""
    taken: set[Page] = set()
    begin = 0
    for image, pixels in zip(planes, images, strict=True):
        blocks = [data for data in pixels.findall("{*}TiffData") if data.attrib or len(data)]
        if blocks:
            placed = [pair for data in blocks for pair in _block(image, data, files)]
        else:
            placed = [(number, ("", begin + number)) for number in range(image.count)]
            begin += image.count
        for number, page in placed:
            if page in taken or number in image.pages:
                raise ValueError("two planes for one page, or two pages for one plane")
            taken.add(page)
            if page[0] or page[1] < files.pages:
                image.pages[number] = page


def _block(image: _Planes, data: ElementTree.Element, files: _Files) -> list[tuple[int, Page]]:
    """Return planes and pages that one ``TiffData`` states."""
    first, page = image.number(data, "First"), int(data.get("IFD", "0"))
    count = int(data.get("PlaneCount", data.get("NumPlanes", "1" if "IFD" in data.attrib else str(files.pages))))
    if page < 0 or not 0 <= count <= MAX_PLANES:
        raise ValueError("a page outside the file")
    file = files.of(data)
    return [(first + k, (file, page + k)) for k in range(min(count, image.count - first))]


def _of_pages(planes: list[_Planes], pages: int) -> dict[str, Any]:
    """Return stage coordinates and exposures of the pages with planes."""
    found = {page: image.elements[n] for image in planes for n, page in image.pages.items() if n in image.elements}
    order = sorted(found)
    facts: dict[str, Any] = {}
    stage = np.array([[_number(found[page], axis) for axis in "XYZ"] for page in order]).reshape(-1, 3)
    exposures = [_value(found[page], "ExposureTime", TIMES, "s") for page in order]
    timed = bool(order) and all(seconds is not None and seconds > 0 for seconds in exposures)
    if len(order) and np.isfinite(stage[:, :2]).all() and np.ptp(stage, axis=0)[:2].any():
        facts |= {"stage_um": stage, "stage_pages": tuple(order)}
        if timed:
            facts["stage_exposure_s"] = np.array(exposures, float)
    if timed and order == [("", k) for k in range(pages)]:
        facts["exposure_s"] = np.array(exposures, float)
    return facts


def _roi(root: ElementTree.Element) -> tuple[int, int, int, int] | None:
    """Return the region of the camera's sensor that the frames show, if a program stored it.

    OME has no element for this region. It may be in an annotation (``ROI``, the name that Micro-Manager uses). It may
    also be a rectangle of the frames' size that does not begin at their first pixel, and so cannot be inside them.
    """
    for entry in root.iter():
        name = entry.tag.rpartition("}")[2]
        if name == "OriginalMetadata":
            key, value = (entry.findtext(f"{{*}}{part}", "") for part in ("Key", "Value"))
        elif name == "M":
            key, value = entry.get("K", ""), entry.text or ""
        else:
            continue
        if key.strip().upper() == "ROI" and (roi := parse_roi(value)) is not None:
            return roi
    pixels = root.find("{*}Image/{*}Pixels")
    for box in root.findall("{*}ROI/{*}Union/{*}Rectangle") if pixels is not None else ():
        try:
            x, y, width, height = (float(box.get(key, "")) for key in ("X", "Y", "Width", "Height"))
            size = (int(pixels.get("SizeX", "0")), int(pixels.get("SizeY", "0")))  # type: ignore[union-attr]
        except ValueError:
            continue
        if (width, height) == size and min(x, y) >= 0 and max(x, y) > 0 and x.is_integer() and y.is_integer():
            return int(x), int(y), *size
    return None


def _modulo(root: ElementTree.Element) -> dict[str, tuple[str, int]]:
    """Return, for each of C, T and Z that annotations split, the secondary axis (such as phase) and its length."""
    found = {}
    for element in root.findall("{*}StructuredAnnotations/{*}XMLAnnotation/{*}Value/{*}Modulo/*"):
        axis, letter = element.tag[-1], {"angle": "A", "phase": "P"}.get(element.get("Type", ""), "Q")
        first, last, step = (
            float(element.get(key, default)) for key, default in (("Start", 0), ("End", 0), ("Step", 1))
        )
        found[axis] = letter, len(element.findall("{*}Label")) or round((last - first) / (step or 1)) + 1
    return found


def _of_order(planes: list[_Planes], pages: int, modulo: dict[str, tuple[str, int]]) -> dict[str, Any]:
    """Return the order of the pages and their axes, for a single image whose planes all have a page."""
    if len(planes) != 1 or len(planes[0].pages) != planes[0].count:
        return {}
    (image,) = planes
    facts: dict[str, Any] = {}
    order = tuple(image.pages[k] for k in range(image.count))
    lead: list[tuple[str, int]] = []
    for axis, n in zip(image.axes[::-1], image.lengths[::-1], strict=True):
        letter, part = modulo.get(axis, ("", 1))
        lead += [(axis, n // part), (letter, part)] if part > 1 and n % part == 0 else [(axis, n)]
    lead = [(axis, n) for axis, n in lead if n > 1]
    # a single plane does not describe the pages after its own
    if order != tuple(("", k) for k in range(pages if lead else 1)):
        facts["page_order"] = order
    if len(lead) > 1:
        facts["scan_axes"] = ("".join(axis for axis, _ in lead), tuple(n for _, n in lead))
    return facts


def _order_notes(planes: list[_Planes], pages: int) -> tuple[str, ...]:
    """Return notes on planes without a page, pages without a plane, and an order other than ``DimensionOrder``."""
    notes = []
    count, there = sum(image.count for image in planes), sum(len(image.pages) for image in planes)
    if count > there:
        notes.append(f"pages: {there} of the {count} planes in the OME metadata have a page; the others are missing")
    own = sum(not page[0] for image in planes for page in image.pages.values())
    if own < pages:
        notes.append(f"pages: {own} of {pages} belong to a plane in the OME metadata; the others are ignored")
    odd = next((image for image in planes if not _rising(image)), None)
    if odd is not None:
        order = f"DimensionOrder XY{odd.axes}"
        notes.append(f"pages: read in the order of TiffData, which differs from {order}")
    return tuple(notes)


def _rising(image: _Planes) -> bool:
    """Return whether the planes of an image are in order in each of its files."""
    last: dict[str, int] = {}
    for number in sorted(image.pages):
        file, page = image.pages[number]
        if page < last.get(file, -1):
            return False
        last[file] = page
    return True


def _number(plane: ElementTree.Element, axis: str) -> float:
    value = _value(plane, f"Position{axis}", LENGTHS, "reference frame")
    return float("nan") if value is None else value


def _value(element: ElementTree.Element, name: str, units: dict[str, float], default: str) -> float | None:
    """Return an attribute in the base unit; None if it is missing, or not a number with a known unit."""
    scale = units.get(element.get(f"{name}Unit", default))
    try:
        value = float(element.get(name, ""))
    except ValueError:
        return None
    return value * scale if scale is not None and np.isfinite(value) else None
