"""The camera as fields of forms, how a change makes a new camera, and what follows from it. No Qt."""

from __future__ import annotations

import html
import math
from dataclasses import replace
from typing import Any

from lfcal.base import LfcalError
from lfcal.camera import Camera, Derived, LensletLattice, LensType, MainLens, Microscope, Sensor, derived_of, doubts
from lfcal_gui.pages.setup.model_fields import MAIN_LENS, MICROSCOPE, SENSOR
from lfcal_gui.pages.setup.model_marks import stated

__all__ = ["apply_change", "facts", "optics_of_kind", "values_of"]


def values_of(camera: Camera) -> dict[str, Any]:
    """Return the value of every field for ``camera``."""
    optics, lattice, sensor = camera.optics, camera.lattice, camera.sensor
    found: dict[str, Any] = {"optics.kind": type(optics).__name__}
    for spec in MAIN_LENS[1:] if isinstance(optics, MainLens) else MICROSCOPE[1:]:
        found[spec.key] = getattr(optics, spec.key.split(".")[1])
    for name in ("kind", "pitch_um", "row_pitch_um", "gap_um", "rotation_rad", "shear_rad", "clear_um"):
        found[f"lattice.{name}"] = getattr(lattice, name)
    found["lattice.offset_x"], found["lattice.offset_y"] = lattice.offset_um
    found["lattice.focus"] = tuple(_tidy(t.focus_depth(lattice.gap_um)) for t in lattice.types)
    found["lattice.distortion"] = _distortion(camera)
    found["sensor.rows"], found["sensor.columns"] = sensor.shape
    for spec in SENSOR[2:]:
        found[spec.key] = getattr(sensor, spec.key.split(".")[1])
    found["camera.wavelength_um"], found["camera.bandwidth_um"] = camera.wavelength_um, camera.bandwidth_um
    return found


def _distortion(camera: Camera) -> str:
    """Return in words what is known of the lattice's distortion."""
    found = camera.lattice.distortion
    if found is not None:
        return f"{found.model}, {found.largest / camera.sensor.pixel_um:.2f} px"
    return "none" if camera.distortion is None else "maker's, not applied"


def _tidy(depth: float) -> float:
    """Return a virtual depth without the dust of its way through a focal length."""
    return depth if math.isinf(depth) else float(f"{depth:.9g}")


def optics_of_kind(camera: Camera, kind: str) -> Camera:
    """Return ``camera`` with optics of another kind, at their defaults."""
    if kind == type(camera.optics).__name__:
        return camera
    return replace(camera, optics=MainLens() if kind == "MainLens" else Microscope())


def apply_change(camera: Camera, key: str, value: Any) -> tuple[Camera | None, str]:
    """Return the camera with one field changed and an empty string, or None and the reason it cannot be."""
    try:
        changed = stated(camera, _changed(camera, key, value), key)
        derived_of(changed)  # raises where nothing follows
        return changed, ""
    except (LfcalError, ZeroDivisionError, OverflowError) as error:
        return None, str(error)


def _changed(camera: Camera, key: str, value: Any) -> Camera:
    part, name = key.split(".")
    if key == "optics.kind":
        return optics_of_kind(camera, value)
    if part == "optics":
        return replace(camera, optics=replace(camera.optics, **{name: value}))
    if part == "sensor":
        return replace(camera, sensor=_sensor(camera.sensor, name, value))
    if part == "lattice":
        return replace(camera, lattice=_lattice(camera.lattice, name, value))
    return replace(camera, **{name: value})


def _sensor(sensor: Sensor, name: str, value: Any) -> Sensor:
    rows, columns = sensor.shape
    if name == "rows":
        return replace(sensor, shape=(value, columns))
    if name == "columns":
        return replace(sensor, shape=(rows, value))
    return replace(sensor, **{name: value})


def _lattice(lattice: LensletLattice, name: str, value: Any) -> LensletLattice:
    x, y = lattice.offset_um
    if name == "offset_x":
        return replace(lattice, offset_um=(value, y))
    if name == "offset_y":
        return replace(lattice, offset_um=(x, value))
    if name == "focus":
        ranges = [t.depth_range for t in lattice.types] + [None] * 3
        types = tuple(LensType.focused_at(v, lattice.gap_um, r) for v, r in zip(value, ranges, strict=False))
        return replace(lattice, types=types)
    if name == "gap_um":  # types keep what they have in focus
        types = tuple(LensType.focused_at(t.focus_depth(lattice.gap_um), value, t.depth_range) for t in lattice.types)
        return replace(lattice, gap_um=value, types=types)
    if name == "kind" and value == "square":
        return replace(_straight(lattice), kind=value, types=lattice.types[:1])
    if name == "kind":
        return replace(_straight(lattice), kind=value)
    return replace(lattice, **{name: value})


def _straight(lattice: LensletLattice) -> LensletLattice:
    """Return the lattice without what was measured of its rows: it was another kind's."""
    return replace(lattice, row_pitch_um=None, shear_rad=0.0, distortion=None)


def facts(camera: Camera) -> str:
    """Return what follows from the description, as rich text; what rests on assumed values in italics, doubts first."""
    cells = "".join(
        f"<tr><td style='padding-right:12px'>{item.label[:1].upper()}{item.label[1:]}</td><td>{_fact(item)}</td></tr>"
        for item in derived_of(camera)
    )
    note = "<p><i>≈ rests on assumed values</i></p>" if any(item.assumed for item in derived_of(camera)) else ""
    questions = "".join(f"<p>⚠ {html.escape(doubt)}</p>" for doubt in doubts(camera))
    return f"{questions}<table cellspacing='1'>{cells}</table>{note}"


def _fact(item: Derived) -> str:
    return f"<i>≈ {item.text}</i>" if item.assumed else f"<b>{item.text}</b>"
