"""The camera as fields of forms, how a change makes a new camera, and what follows from it. No Qt."""

from __future__ import annotations

import html
import math
from dataclasses import replace
from typing import Any

from gui.models.form import Field
from gui.pages.camera.model_marks import stated
from lfcal.camera import Camera, Derived, LensletLattice, LensType, MainLens, Microscope, Sensor, derived_of, doubts
from lfcal.errors import LfcalError

__all__ = [
    "LATTICE",
    "MAIN_LENS",
    "MICROSCOPE",
    "SENSOR",
    "apply_change",
    "facts",
    "optics_of_kind",
    "values_of",
]


DEGREE = math.pi / 180

MAIN_LENS = (
    Field(
        "optics.kind",
        "Optics",
        kind="choice",
        choices=(("MainLens", "main lens"), ("Microscope", "microscope")),
        tip="A photographic main lens, or a telecentric microscope",
    ),
    Field("optics.focal_length_um", "Focal length", "mm", "Focal length of the main lens", scale=1e3),
    Field("optics.f_number", "f-number", "", "As set on the lens: focal length over entrance pupil"),
    Field(
        "optics.working_distance_um",
        "Working distance",
        "mm",
        "From the lens to the plane whose image lies on the lenslets",
        scale=1e3,
    ),
    Field("optics.blades", "Iris blades", "", "0 is a circular iris", kind="int"),
    Field(
        "optics.blade_rotation_rad",
        "Iris rotation",
        "°",
        "Angle of the first vertex from the column axis",
        scale=DEGREE,
    ),
    Field("optics.blade_curvature", "Blade curvature", "", "0 straight edges … 1 a circle"),
)

MICROSCOPE = (
    MAIN_LENS[0],
    Field("optics.magnification", "Magnification", "×", "Objective and tube lens together"),
    Field("optics.numerical_aperture", "Numerical aperture", "", "Object-side NA of the objective"),
    Field("optics.medium_index", "Medium index", "", "Refractive index of the immersion medium"),
    Field("optics.tube_length_um", "Tube lens", "mm", "Focal length of the tube lens", scale=1e3),
)

LATTICE = (
    Field(
        "lattice.kind",
        "Array",
        kind="choice",
        choices=(("hexagonal", "hexagonal"), ("square", "square")),
        tip="Arrangement of the lenslets",
    ),
    Field("lattice.pitch_um", "Pitch", "µm", "Distance of neighbouring micro-images along a row, on the sensor"),
    Field(
        "lattice.row_pitch_um",
        "Row distance",
        "µm",
        "Distance of rows if not the ideal one; empty: ideal",
        optional=True,
    ),
    Field("lattice.gap_um", "Gap to the sensor", "µm", "Distance B from lenslets to sensor"),
    Field(
        "lattice.rotation_rad", "Rotation", "°", "From the column axis towards the row axis (clockwise)", scale=DEGREE
    ),
    Field("lattice.offset_x", "Offset x", "µm", "Centre of a type-0 micro-image, right of the sensor's centre"),
    Field("lattice.offset_y", "Offset y", "µm", "Centre of a type-0 micro-image, below the sensor's centre"),
    Field("lattice.clear_um", "Clear diameter", "µm", "Of a lenslet; empty: the full pitch", optional=True),
    Field(
        "lattice.focus",
        "Types in focus at v",
        "",
        "Virtual depths in focus, one or three; inf: focused at infinity (f = gap)",
        kind="floats",
    ),
)

SENSOR = (
    Field("sensor.rows", "Rows", "px", "Pixels from top to bottom", kind="int"),
    Field("sensor.columns", "Columns", "px", "Pixels from left to right", kind="int"),
    Field("sensor.pixel_um", "Pixel pitch", "µm", "Seen at the lenslets, if relay optics lie between"),
    Field("sensor.bit_depth", "Bit depth", "bit", "Bits per sample", kind="int"),
    Field("sensor.full_well_e", "Full well", "e⁻", "Electrons at the highest sample value"),
    Field("sensor.read_noise_e", "Read noise", "e⁻ rms", "Noise without light"),
    Field("sensor.dark_current_e_s", "Dark current", "e⁻/s", "Per pixel"),
    Field("sensor.black_level", "Black level", "counts", "Sample value without light"),
    Field("sensor.prnu", "PRNU", "", "Pixel response non-uniformity, rms, relative"),
    Field("sensor.quantum_efficiency", "Quantum efficiency", "", "Detected share of photons"),
    Field("sensor.fill_factor", "Fill factor", "", "Light-sensitive share of a pixel"),
    Field("sensor.cfa", "Colour filter", "", "Pattern by rows, e.g. GRBG; empty: monochrome", kind="text"),
    Field("camera.wavelength_um", "Wavelength", "nm", "Of the light the camera is calibrated with", scale=1e-3),
    Field("camera.bandwidth_um", "Bandwidth", "nm", "Full width of the light's spectrum", scale=1e-3),
)


def values_of(camera: Camera) -> dict[str, Any]:
    """Return the value of every field for ``camera``."""
    optics, lattice, sensor = camera.optics, camera.lattice, camera.sensor
    found: dict[str, Any] = {"optics.kind": type(optics).__name__}
    for spec in MAIN_LENS[1:] if isinstance(optics, MainLens) else MICROSCOPE[1:]:
        found[spec.key] = getattr(optics, spec.key.split(".")[1])
    for name in ("kind", "pitch_um", "row_pitch_um", "gap_um", "rotation_rad", "clear_um"):
        found[f"lattice.{name}"] = getattr(lattice, name)
    found["lattice.offset_x"], found["lattice.offset_y"] = lattice.offset_um
    found["lattice.focus"] = tuple(_tidy(t.focus_depth(lattice.gap_um)) for t in lattice.types)
    found["sensor.rows"], found["sensor.columns"] = sensor.shape
    for spec in SENSOR[2:-2]:
        found[spec.key] = getattr(sensor, spec.key.split(".")[1])
    found["camera.wavelength_um"], found["camera.bandwidth_um"] = camera.wavelength_um, camera.bandwidth_um
    return found


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
        return replace(lattice, kind=value, types=lattice.types[:1], row_pitch_um=None)
    if name == "kind":
        return replace(lattice, kind=value, row_pitch_um=None)
    return replace(lattice, **{name: value})


def facts(camera: Camera) -> str:
    """Return what follows from the description, as rich text; what rests on assumed values in italics, doubts first."""
    cells = "".join(
        f"<tr><td style='padding-right:12px'>{item.label[:1].upper()}{item.label[1:]}</td><td>{_fact(item)}</td></tr>"
        for item in derived_of(camera)
    )
    note = "<p><i>≈ rests on assumed values</i></p>" if any(item.assumed for item in derived_of(camera)) else ""
    questions = "".join(f"<p>⚠ {html.escape(doubt)}</p>" for doubt in doubts(camera))
    return f"{questions}<table cellspacing='2'>{cells}</table>{note}"


def _fact(item: Derived) -> str:
    return f"<i>≈ {item.text}</i>" if item.assumed else f"<b>{item.text}</b>"
