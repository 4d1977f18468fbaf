"""What OME metadata say of the planes of a TIFF: where the stage stood, exposures, size of a pixel."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

import numpy as np

__all__ = ["ome_facts"]

LENGTHS = {"µm": 1.0, "μm": 1.0, "um": 1.0, "mm": 1e3, "nm": 1e-3, "m": 1e6, "cm": 1e4, "reference frame": 1.0}
"""Micrometres of OME's units; its default for positions is a frame of reference without unit, as µm in practice."""
TIMES = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "μs": 1e-6, "min": 60.0}
MAX_CHARACTERS = 1 << 26


def ome_facts(text: str, pages: int) -> dict[str, Any]:
    """Return what OME-XML ``text`` states of ``pages`` planes, as far as it states it of every one.

    ``stage_um`` ``(pages, 3)`` as (x, y, z), NaN where an axis is not stated; ``exposure_s`` ``(pages,)``;
    ``pixel_um``. Anything else, and what cannot be read, is left out: the pictures are there without it.
    """
    # entities are how a small XML becomes a large one; OME needs none
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
    planes = [plane for pixels in images for plane in _in_order(pixels)]
    if len(planes) != pages:
        return facts
    stage = np.array([[_number(plane, axis) for axis in "XYZ"] for plane in planes])
    if np.isfinite(stage[:, :2]).all() and np.ptp(stage, axis=0)[:2].any():
        facts["stage_um"] = stage
    exposures = [_value(plane, "ExposureTime", TIMES, "s") for plane in planes]
    if all(seconds is not None and seconds > 0 for seconds in exposures):
        facts["exposure_s"] = np.array(exposures, float)
    return facts


def _in_order(pixels: ElementTree.Element) -> list[ElementTree.Element]:
    """Return the planes of an image in the order of its pages."""
    order = pixels.get("DimensionOrder", "XYCZT")[2:]

    def place(plane: ElementTree.Element) -> list[int]:
        # the first letter runs fastest
        return [int(plane.get(f"The{axis}", "0")) for axis in reversed(order)]

    try:
        return sorted(pixels.findall("{*}Plane"), key=place)
    except ValueError:
        return []


def _number(plane: ElementTree.Element, axis: str) -> float:
    value = _value(plane, f"Position{axis}", LENGTHS, "reference frame")
    return float("nan") if value is None else value


def _value(element: ElementTree.Element, name: str, units: dict[str, float], default: str) -> float | None:
    """Return an attribute in the base unit; None where it is not there or no number of a known unit."""
    scale = units.get(element.get(f"{name}Unit", default))
    try:
        value = float(element.get(name, ""))
    except ValueError:
        return None
    return value * scale if scale is not None and np.isfinite(value) else None
