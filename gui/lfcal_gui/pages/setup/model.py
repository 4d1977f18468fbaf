"""The camera: form fields, sources of values, changes, and derived quantities. No Qt."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, LfcalError, drain
from lfcal.camera import (
    QUANTITIES,
    Camera,
    Derived,
    Draft,
    LensletLattice,
    LensType,
    MainLens,
    Marks,
    Microscope,
    PupilLenslets,
    ScanPlan,
    Sensor,
    derived_of,
    doubts,
    quantities_of,
    read_camera_value,
)
from lfcal_gui.models import Field, ProjectState
from lfcal_gui.pages.setup.model_scan import default_plan

if TYPE_CHECKING:
    from lfcal.simulate import AssumedEffect

DEGREE = math.pi / 180

OPTICS = (("MainLens", "main lens"), ("Microscope", "microscope"), ("FourierMicroscope", "Fourier microscope"))
KINDS = "A photographic main lens, a telecentric microscope, or a microscope with lenslets in a pupil plane"
APERTURES = (("round", "round"), ("square", "square"))
CENTRES = "Centre of each lenslet relative to the optical axis: x, y; x, y; …, to the right and downwards"
ARRAYS = (("hexagonal", "hexagonal"), ("square", "square"))
CLEAR = "Diameter of a round lenslet on the sensor; empty: squares without gaps, or discs as wide as the pitch"
FARTHEST = 1e6
"""Largest virtual depth in focus that a focal length distinguishes from infinity."""

FOCUS = "Virtual depths in focus, one or three; inf: focused at infinity (f = gap)"
DISTORTED = "Deviation of the micro-images from straight rows, and its largest value; measured in a white image"
SATURATED = "Smallest sample value that is saturated; empty: the highest value"

MAIN_LENS = (
    Field(
        "optics.kind",
        "Optics",
        "",
        KINDS,
        "choice",
        choices=OPTICS,
    ),
    Field("optics.focal_length_um", "Focal length", "mm", "Focal length of the main lens", scale=1e3),
    Field(
        "optics.f_number",
        "f-number",
        "",
        "f-number set on the lens: focal length divided by the diameter of the entrance pupil",
    ),
    Field(
        "optics.working_distance_um",
        "Distance",
        "mm",
        "Distance from the lens to the plane that is imaged onto the lenslets",
        scale=1e3,
    ),
    Field("optics.blades", "Iris blades", "", "0 is a circular iris", "int"),
    Field(
        "optics.blade_rotation_rad",
        "Iris rotation",
        "°",
        "Angle of the first vertex from the column axis",
        scale=DEGREE,
    ),
    Field("optics.blade_curvature", "Blade curvature", "", "From 0 (straight edges) to 1 (a circle)"),
)

MICROSCOPE = (
    MAIN_LENS[0],
    Field("optics.magnification", "Magnification", "×", "Objective and tube lens together"),
    Field("optics.numerical_aperture", "Numerical aperture", "", "Object-side NA of the objective"),
    Field("optics.medium_index", "Medium index", "", "Refractive index of the immersion medium"),
    Field("optics.tube_length_um", "Tube lens", "mm", "Focal length of the tube lens", scale=1e3),
)

LATTICE = (
    Field("lattice.kind", "Array", "", "Arrangement of the lenslets", "choice", choices=ARRAYS),
    Field("lattice.pitch_um", "Pitch", "µm", "Distance between neighbouring micro-images along a row, on the sensor"),
    Field(
        "lattice.row_pitch_um",
        "Row distance",
        "µm",
        "Distance between rows of micro-images, if it differs from that of the ideal lattice",
        optional=True,
        empty="ideal",
    ),
    Field("lattice.gap_um", "Gap", "µm", "Distance B from lenslets to sensor"),
    Field(
        "lattice.rotation_rad",
        "Rotation",
        "°",
        "Angle from the horizontal axis of the sensor to the rows of the lattice, positive clockwise",
        scale=DEGREE,
    ),
    Field("lattice.shear_rad", "Shear", "°", "Shear angle of the rows relative to the ideal lattice", scale=DEGREE),
    Field(
        "lattice.offset_x",
        "Offset x",
        "µm",
        "Distance of the centre of a type-0 micro-image to the right of the sensor's centre",
    ),
    Field(
        "lattice.offset_y", "Offset y", "µm", "Distance of the centre of a type-0 micro-image below the sensor's centre"
    ),
    Field("lattice.clear_um", "Clear diameter", "µm", CLEAR, optional=True, empty="as wide as the pitch"),
    Field("lattice.focus", "Types in focus at v", "", FOCUS, "floats", endless=True),
    Field("lattice.distortion", "Distortion", "", DISTORTED, "shown"),
    Field("lattice.fourier_um", "Fourier lens", "mm", "Focal length of the lens between image and lenslets", scale=1e3),
    Field(
        "lattice.focal_lengths_um",
        "Lenslets' focal lengths",
        "µm",
        "One value for all lenslets, or one for each lenslet",
        "floats",
    ),
    Field("lattice.lens_centres_um", "Lenslet centres", "µm", CENTRES, "text"),
    Field("lattice.aperture", "Aperture", "", "Outline of a lenslet", "choice", choices=APERTURES),
)

UNKNOWN: dict[str, Any] = {"optional": True, "empty": "not known"}
SENSOR = (
    Field("sensor.rows", "Rows", "px", "Pixels from top to bottom", "int"),
    Field("sensor.columns", "Columns", "px", "Pixels from left to right", "int"),
    Field(
        "sensor.pixel_um", "Pixel pitch", "µm", "Distance between pixels. With relay optics: as imaged at the lenslets"
    ),
    Field("sensor.bit_depth", "Bit depth", "bit", "Bits per sample", "int"),
    Field("sensor.full_well_e", "Full well", "e⁻", "Electrons at the highest sample value"),
    Field("sensor.saturation", "Saturation", "counts", SATURATED, optional=True, empty="the highest"),
    Field("sensor.read_noise_e", "Read noise", "e⁻ rms", "Noise of a sample without light"),
    Field(
        "sensor.dark_current_e_s", "Dark current", "e⁻/s", "Dark current of each pixel. It adds noise in long exposures"
    ),
    Field("sensor.black_level", "Black level", "counts", "Sample value without light"),
    Field("sensor.prnu", "PRNU", "", "Relative rms variation of the pixels' response (photo-response non-uniformity)"),
    Field("sensor.dsnu_e", "DSNU", "e⁻ rms", "Variation of the pixel offsets in the dark; empty: not known", **UNKNOWN),
    Field(
        "sensor.linearity",
        "Non-linearity",
        "",
        "Largest relative deviation of the signal from a straight line",
        **UNKNOWN,
    ),
    Field("sensor.quantum_efficiency", "Quantum efficiency", "", "Fraction of photons that are detected"),
    Field("sensor.fill_factor", "Fill factor", "", "Light-sensitive fraction of a pixel"),
    Field(
        "sensor.cfa",
        "Colour filter",
        "",
        "Pattern in row-major order, such as GRBG; empty: monochrome",
        "text",
        empty="monochrome",
    ),
)

LIGHT = (
    Field("camera.wavelength_um", "Wavelength", "nm", "Wavelength of the light used for calibration", scale=1e-3),
    Field("camera.bandwidth_um", "Bandwidth", "nm", "Full width of the spectrum of the light", scale=1e-3),
)

OF_A_LATTICE = ("kind", "pitch_um", "row_pitch_um", "gap_um", "rotation_rad", "shear_rad", "clear_um")
IN_A_PUPIL = ("fourier_um", "gap_um", "focal_lengths_um", "clear_um", "aperture")
"""Attributes of a lattice that have a field of the same name: of lenslets in an image plane, and in a pupil plane."""

BASIC = (
    *("optics.focal_length_um", "optics.f_number", "optics.working_distance_um"),
    *("optics.magnification", "optics.numerical_aperture", "optics.tube_length_um"),
    *("lattice.pitch_um", "lattice.fourier_um", "sensor.pixel_um", "camera.wavelength_um"),
)
"""Essential values: three of a main lens or a microscope, and three others."""


PATHS = {
    "optics.kind": "",
    "sensor.rows": "sensor.shape",
    "sensor.columns": "sensor.shape",
    "lattice.focus": "lattice.types",
    "lattice.offset_x": "lattice.offset_um",
    "lattice.offset_y": "lattice.offset_um",
    "camera.wavelength_um": "wavelength_um",
    "camera.bandwidth_um": "bandwidth_um",
}
"""Fields whose value has another path in the description."""

CHOSEN = ("depths_um", "stage", "order", "exposure_s", "settle_s", "frames_averaged", "resample")
"""Fields of a plan that do not follow from the camera."""

TOGETHER = {"lattice.offset_um": "offset", "sensor.shape": "rows and columns"}
"""Names of values that are shown in two fields."""

OF_ROWS = ("lattice.row_pitch_um", "lattice.shear_rad", "lattice.distortion")
"""Values that are reset if the kind of array changes."""

TIPS = {
    "assumed": "This value was not stated, so lfcal uses a typical one. Type the true value, or click "
    "the mark if it is right.",
    "derived": "This value is derived from stated or measured values.",
    "measured": "This value was measured in frames of the camera.",
    "stated": "This value is stated.",
}


def path_of(key: str) -> str:
    """Return the path of a field in the camera description; empty if it has none."""
    return PATHS.get(key, key)


def mark_of(camera: Camera, key: str) -> str:
    """Return the source of the value of a field."""
    path = path_of(key)
    return camera.marks[path] if path else "stated"


def confirmed(camera: Camera, paths: Iterable[str]) -> Camera:
    """Return ``camera`` with the values at ``paths`` marked as stated, because the user confirmed them."""
    return replace(camera, marks=camera.marks.marked(paths, "stated"))


def all_assumed(camera: Camera) -> Camera:
    """Return ``camera`` with every value marked as assumed, as a start for a description."""
    return replace(camera, marks=Marks.of({q.path: "assumed" for q in quantities_of(camera)}))


def stated(before: Camera, after: Camera, key: str) -> Camera:
    """Return ``after``, which differs from ``before`` in one field, with that field marked as stated.

    With another kind of optics, the values of the replaced parts are marked as assumed.
    """
    if key == "optics.kind":
        changed = [k for k in ("optics", "lattice") if type(getattr(before, k)) is not type(getattr(after, k))]
        parts = tuple(f"{part}." for part in changed)
        kept = {path: mark for path, mark in after.marks if not path.startswith(parts)}
        taken = {q.path: "assumed" for q in quantities_of(after) if q.path.startswith(parts)}
        return replace(after, marks=Marks.of(kept | taken)) if parts else after
    if key == "lattice.kind" and before.lattice.kind != after.lattice.kind:
        after = replace(after, marks=Marks.of({path: mark for path, mark in after.marks if path not in OF_ROWS}))
    path = path_of(key)
    # a value without a mark is stated already
    return confirmed(after, [path]) if path and after.marks[path] != "stated" else after


def state_with(state: ProjectState, camera: Camera, *, same: bool = False) -> dict[str, object]:
    """Return the changes of a project for a new camera.

    The plan is kept if the image geometry is unchanged. If the camera is the ``same`` with another description, a new
    plan is made with the planes, exposures and stage of the old one. Its cutout and anchor are kept, unless they were
    the suggested ones. For another camera, the plan is removed.
    """
    plan = state.plan
    if plan is not None and _same_geometry(state.camera, camera):
        plan = replace(plan, camera=camera)
    elif plan is not None:
        plan = carried(plan, camera) if same else None
    return {"camera": camera, "plan": plan}


def carried(plan: ScanPlan, camera: Camera) -> ScanPlan | None:
    """Return the plan adapted to ``camera``; None if its planes cannot be scanned with this camera."""
    chosen = {name: getattr(plan, name) for name in CHOSEN}
    try:
        suggested = ScanPlan.for_camera(plan.camera, depths_um=plan.depths_um, resample=plan.resample)
        for name in ("cutout", "anchor"):
            if getattr(plan, name) != getattr(suggested, name):
                chosen[name] = getattr(plan, name)
    except (LfcalError, ZeroDivisionError, OverflowError):
        return None
    for kept in (chosen, {name: chosen[name] for name in CHOSEN}):  # a cutout or an anchor may lie outside now
        try:
            return ScanPlan.for_camera(camera, **kept)
        except (LfcalError, ZeroDivisionError, OverflowError):
            continue
    return None


def name_at(path: str) -> str:
    """Return the name, for use in a sentence, of the value at a path of the description."""
    fields = (*MAIN_LENS, *MICROSCOPE, *LATTICE, *SENSOR, *LIGHT)
    others = {one.path: one.label for one in QUANTITIES}
    name = next((one.label for one in fields if path_of(one.key) == path), others.get(path, path))
    name = TOGETHER.get(path, name)
    return name[:1].lower() + name[1:] if name[1:2].islower() else name


def weighed_key(state: ProjectState) -> tuple[Any, ...] | None:
    """Return everything on which the effects of assumed values depend; None if no value is assumed."""
    camera, plan = state.camera, state.plan
    assumed = camera.marks.paths("assumed")
    # time is relative, so that neither exposures nor averages matter much; the cutout does not matter at all
    return (camera, assumed, None if plan is None else plan.depths_um) if assumed else None


def weighed(state: ProjectState) -> tuple[AssumedEffect, ...]:
    """Return the effect of each assumed value, largest first; takes about a second."""
    from lfcal.simulate import iter_assumed_effects

    return drain(iter_assumed_effects(state.plan or default_plan(state.camera)))


def _same_geometry(one: Camera, other: Camera) -> bool:
    """Return whether two cameras differ only in noise and levels, so that planes, cutout and anchor are the same."""
    sensor = replace(other.sensor, shape=one.sensor.shape, pixel_um=one.sensor.pixel_um)
    return sensor == other.sensor and replace(one, sensor=other.sensor) == other


def values_of(camera: Camera) -> dict[str, Any]:
    """Return the value of every field for ``camera``."""
    optics, lattice, sensor = camera.optics, camera.lattice, camera.sensor
    found: dict[str, Any] = {"optics.kind": kind_of(camera)}
    for spec in MAIN_LENS[1:] if isinstance(optics, MainLens) else MICROSCOPE[1:]:
        found[spec.key] = getattr(optics, spec.key.split(".")[1])
    for name in IN_A_PUPIL if isinstance(lattice, PupilLenslets) else OF_A_LATTICE:
        found[f"lattice.{name}"] = getattr(lattice, name)
    found["lattice.offset_x"], found["lattice.offset_y"] = lattice.offset_um
    if isinstance(lattice, PupilLenslets):
        found["lattice.lens_centres_um"] = "; ".join(f"{x:.9g}, {y:.9g}" for x, y in lattice.lens_centres_um)
    else:
        found["lattice.focus"] = tuple(_tidy(t.focus_depth(lattice.gap_um)) for t in lattice.types)
        found["lattice.distortion"] = _distortion(camera)
    found["sensor.rows"], found["sensor.columns"] = sensor.shape
    for spec in SENSOR[2:]:
        found[spec.key] = getattr(sensor, spec.key.split(".")[1])
    found["camera.wavelength_um"], found["camera.bandwidth_um"] = camera.wavelength_um, camera.bandwidth_um
    return found


def kind_of(camera: Camera) -> str:
    """Return the kind of camera, one of `OPTICS`."""
    return type(camera.optics).__name__ if camera.has_lattice else "FourierMicroscope"


def _distortion(camera: Camera) -> str:
    found = camera.periodic.distortion
    if found is not None:
        return f"{found.model}, {found.largest / camera.sensor.pixel_um:.2f} px"
    return "none" if camera.distortion is None else "manufacturer's, not applied"


def _tidy(depth: float) -> float:
    """Return a virtual depth without the rounding error of its conversion to a focal length and back."""
    return depth if math.isinf(depth) else float(f"{depth:.9g}")


def optics_of_kind(camera: Camera, kind: str) -> Camera:
    """Return ``camera`` with optics of another kind, at their defaults."""
    if kind == kind_of(camera):
        return camera
    optics = camera.optics
    if kind == "MainLens" or isinstance(optics, MainLens):
        optics = MainLens() if kind == "MainLens" else Microscope()
    if kind == "FourierMicroscope":
        lattice: LensletLattice | PupilLenslets = Draft(kind).camera("").lattice
    else:
        lattice = camera.lattice if camera.has_lattice else Draft(kind).camera("").lattice
    return replace(camera, optics=optics, lattice=lattice)


def apply_change(camera: Camera, key: str, value: Any) -> tuple[Camera | None, str]:
    """Return the camera with one field changed and ``""``, or None and the reason why the value is refused."""
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


def _lattice(lattice: LensletLattice | PupilLenslets, name: str, value: Any) -> LensletLattice | PupilLenslets:
    x, y = lattice.offset_um
    if name == "offset_x":
        return replace(lattice, offset_um=(value, y))
    if name == "offset_y":
        return replace(lattice, offset_um=(x, value))
    if isinstance(lattice, PupilLenslets):
        own = read_camera_value("lattice.lens_centres_um", value) if name == "lens_centres_um" else value
        return replace(lattice, **{name: own})
    if name == "focus":
        if far := [v for v in value if FARTHEST < abs(v) < math.inf]:
            raise InputError.expected(
                "virtual depths in focus", "numbers from −1e6 to 1e6, or inf", f"{far[0]:g}", "write inf for infinity"
            )
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
    """Return the lattice without the measured distortion, which is not valid for another kind of lattice."""
    return replace(lattice, row_pitch_um=None, shear_rad=0.0, distortion=None)


def facts(camera: Camera) -> str:
    """Return quantities derived from the description as rich text: doubts first, uncertain values in italics."""
    cells = "".join(
        f"<tr><td style='padding-right:12px'>{item.label[:1].upper()}{item.label[1:]}</td><td>{_fact(item)}</td></tr>"
        for item in derived_of(camera)
    )
    note = "<p><i>≈ depends on assumed values</i></p>" if any(item.assumed for item in derived_of(camera)) else ""
    questions = "".join(f"<p>⚠ {html.escape(doubt)}</p>" for doubt in doubts(camera))
    return f"{questions}<table cellspacing='1'>{cells}</table>{note}"


def _fact(item: Derived) -> str:
    text = item.text.replace(" ", "&nbsp;")
    return f"<i>≈&nbsp;{text}</i>" if item.assumed else f"<b>{text}</b>"
