"""Quantities derived from a camera's values, with the assumed values on which they depend."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfcal.base import InputError, format_length
from lfcal.camera.description import Camera
from lfcal.camera.main_lens import MainLens
from lfcal.camera.pupil_lenslets import PupilLenslets
from lfcal.camera.quantities import quantities_of

__all__ = ["DEPTH", "NOISE", "STEP", "WHOLE_FRAMES", "Derived", "assumed_of", "derived_of", "not_stated_for_noise"]

STEP = (
    "sensor.pixel_um",
    "optics.focal_length_um",
    "optics.working_distance_um",
    "optics.magnification",
    "lattice.gap_um",
    "lattice.fourier_um",
)
"""Paths of the values on which the source's step depends; the gap only for a main lens or without a lattice."""
DEPTH = (
    "optics.focal_length_um",
    "optics.working_distance_um",
    "optics.magnification",
    "lattice.gap_um",
    "lattice.fourier_um",
)
APERTURE = (
    "optics.focal_length_um",
    "optics.f_number",
    "optics.working_distance_um",
    "optics.magnification",
    "optics.numerical_aperture",
)
WHOLE_FRAMES = ("sensor.shape",)
IN_PIXELS = ("lattice.pitch_um", "lattice.kind")
NOISE = ("sensor.full_well_e", "sensor.read_noise_e", "sensor.bit_depth")


@dataclass(frozen=True, slots=True)
class Derived:
    """A quantity derived from the values of a camera, with its unit.

    Attributes
    ----------
    label, text
        Name of the quantity, and its value and unit as text.
    value
        Value in ``unit``. A tuple is (y, x), or (x, y) for the type-0 micro-image. For depths, it is (near limit, in
        focus, far limit).
    unit
        Unit of ``value``, as in the camera description; it may differ from that in ``text``.
    assumed
        Paths of the assumed camera values on which the quantity depends.

    Examples
    --------
    >>> from lfcal.camera import Derived, derived_of, preset
    >>> number: Derived = next(one for one in derived_of(preset("r29")) if one.label == "working f-number")
    >>> print(f"f/{number.text}", number.assumed)
    f/5 ()
    """

    label: str
    text: str
    value: float | tuple[float, ...]
    unit: str
    assumed: tuple[str, ...]


def assumed_of(camera: Camera, paths: tuple[str, ...]) -> tuple[str, ...]:
    """Return those of ``paths`` (such as `STEP` or `DEPTH`) at which the value of ``camera`` is assumed.

    The gap is left out if the magnification does not depend on it.
    """
    return _assumed(camera, _that_matter(camera, paths))


def _assumed(camera: Camera, paths: tuple[str, ...]) -> tuple[str, ...]:
    there = set(camera.marks.paths("assumed"))
    return tuple(path for path in paths if path in there)


def _that_matter(camera: Camera, paths: tuple[str, ...]) -> tuple[str, ...]:
    """Return ``paths``, without the gap if magnification does not depend on it (telecentric optics and a lattice)."""
    unneeded = camera.has_lattice and camera.optics.telecentric
    return tuple(path for path in paths if not (unneeded and path == "lattice.gap_um"))


def not_stated_for_noise(camera: Camera) -> tuple[str, ...]:
    """Return the display names of the assumed camera values on which the noise of H depends; empty if there are none.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import Marks, not_stated_for_noise, preset
    >>> camera = replace(preset("bench"), marks=Marks.of({"sensor.read_noise_e": "assumed"}))
    >>> not_stated_for_noise(camera)
    ('read noise',)
    """
    paths = assumed_of(camera, NOISE)
    return tuple(q.label for q in quantities_of(camera) if q.path in paths)


def derived_of(camera: Camera) -> tuple[Derived, ...]:
    """Return the quantities derived from ``camera``: on the sensor, in the optics and in object space.

    Raises
    ------
    InputError
        If values of the camera are so extreme that the quantities cannot be calculated.

    Examples
    --------
    >>> from lfcal.camera import derived_of, preset
    >>> for one in derived_of(preset("lfm_20x05"))[:7]:
    ...     print(f"{one.label}: {one.text}")
    micro-image pitch: 15.0000 px
    period (x × y): 15.000 × 15.000 px
    positions in it (x × y): 15 × 15
    type-0 micro-image (x, y): +0.000, +0.000 px
    working f-number: 20
    f-number of the lenslets: 20
    micro-image diameter / lenslet pitch: 1
    """
    try:
        if isinstance(camera.lattice, PupilLenslets):
            found = [*_elemental_images(camera, camera.lattice), *_in_object_space(camera)]
        else:
            found = [*_on_the_sensor(camera), *_in_the_optics(camera), *_in_object_space(camera)]
    except ArithmeticError:  # a division by almost zero, or an overflow
        raise InputError.expected(
            "camera", "values of a real camera", "values too extreme for a calculation", "check units and exponents"
        ) from None
    return tuple(Derived(*row[:4], _assumed(camera, row[4])) for row in found)


_Row = tuple[str, str, float | tuple[float, ...], str, tuple[str, ...]]


def _on_the_sensor(camera: Camera) -> list[_Row]:
    (py, px), (x, y) = camera.period_px, camera.lattice.offset_um
    x, y = x / camera.sensor.pixel_um, y / camera.sensor.pixel_um
    count = (max(1, round(py)), max(1, round(px)))
    return [
        ("micro-image pitch", f"{camera.pitch_px:.4f} px", camera.pitch_px, "px", IN_PIXELS),
        ("period (x × y)", f"{px:.3f} × {py:.3f} px", (py, px), "px", IN_PIXELS),
        ("positions in it (x × y)", f"{count[1]} × {count[0]}", count, "", IN_PIXELS),
        ("type-0 micro-image (x, y)", f"{x:+.3f}, {y:+.3f} px", (x, y), "px", ("lattice.offset_um",)),
    ]


def _in_the_optics(camera: Camera) -> list[_Row]:
    optics, lattice = camera.optics, camera.lattice
    gap, number = lattice.gap_um, optics.working_f_number
    lenslet = gap / lattice.pitch_um
    lens = ("lattice.gap_um", "lattice.pitch_um")
    rows: list[_Row] = [
        ("working f-number", f"{number:.4g}", number, "", APERTURE),
        ("f-number of the lenslets", f"{lenslet:.4g}", lenslet, "", lens),
        ("micro-image diameter / lenslet pitch", f"{lenslet / number:.3g}", lenslet / number, "", (*APERTURE, *lens)),
        ("magnification |M|", f"{camera.magnification:.4g}", camera.magnification, "", _that_matter(camera, DEPTH)),
    ]
    if not optics.telecentric:
        distance = optics.image_distance_um
        rows.insert(0, ("lens to lenslets", format_length(distance), distance, "µm", DEPTH[:2]))
    return rows


def _elemental_images(camera: Camera, lenslets: PupilLenslets) -> list[_Row]:
    optics = camera.optics
    assert not isinstance(optics, MainLens)
    pupil, px = lenslets.pupil_um(optics), camera.sensor.pixel_um
    share = lenslets.clear_um / pupil
    fine = camera.wavelength_um / (2 * optics.numerical_aperture * share)
    relay = ("optics.magnification", "lattice.gap_um", "lattice.fourier_um")
    aperture = ("optics.magnification", "optics.numerical_aperture", "lattice.fourier_um")
    count = len(lenslets.lens_centres_um)
    rows: list[_Row] = [
        ("elemental images", str(count), float(count), "", ("lattice.lens_centres_um",)),
        ("pupil on the lenslets", format_length(pupil), pupil, "µm", aperture),
        ("lenslet diameter / pupil", f"{share:.3g}", share, "", (*aperture, "lattice.clear_um")),
        ("magnification |M|", f"{camera.magnification:.4g}", camera.magnification, "", relay),
        ("resolution λ/(2 NA) of a lenslet", format_length(fine), fine, "µm", (*aperture, "lattice.clear_um")),
    ]
    if count > 1:
        apart = lenslets.spacing_um
        field = apart / camera.magnification
        rows.append(
            ("between elemental images", f"{apart / px:.2f} px", apart / px, "px", ("lattice.lens_centres_um",))
        )
        rows.append(("field without overlap", format_length(field), field, "µm", (*relay, "lattice.lens_centres_um")))
    return rows


def _in_object_space(camera: Camera) -> list[_Row]:
    step, paths = camera.step_um(), _that_matter(camera, STEP)
    rows, columns = camera.sensor.shape
    field = (rows * step, columns * step)
    shown = f"{format_length(field[1])} × {format_length(field[0])}"
    found: list[_Row] = [
        ("step for one pixel", format_length(step), step, "µm", paths),
        ("field of view (x × y)", shown, field, "µm", (*paths, *WHOLE_FRAMES)),
    ]
    for k, kind in enumerate(camera.lattice.types if camera.has_lattice else ()):
        focus = kind.focus_depth(camera.lattice.gap_um)
        ends = kind.depth_range or (focus, focus)
        rests = (*DEPTH, "lattice.types")
        found.append((f"type {k}: in focus at v", f"{focus:.4g}{_ends(kind.depth_range)}", focus, "", rests))
        depths = tuple(_depth(camera, v) for v in (ends[0], focus, ends[1]))
        if all(math.isfinite(z) for z in depths) and kind.depth_range:
            text = f"{format_length(depths[1])}, used {format_length(depths[0])} … {format_length(depths[2])}"
            found.append(("  object depth z", text, depths, "µm", rests))
    if camera.optics.telecentric:
        found.append(_depth_of_field(camera))
    return found


def _ends(ends: tuple[float, float] | None) -> str:
    return "" if ends is None else f", used {ends[0]:g} … {ends[1]:g}"


def _depth(camera: Camera, virtual: float) -> float:
    try:
        return camera.depth_of(virtual) if math.isfinite(virtual) else math.nan
    except InputError:  # no object is imaged there
        return math.nan


def _depth_of_field(camera: Camera) -> _Row:
    """Return the depth of field of the objective alone, λn/NA² (µm)."""
    optics = camera.optics
    assert not isinstance(optics, MainLens)
    depth = camera.wavelength_um * optics.medium_index / optics.numerical_aperture**2
    rests = ("wavelength_um", "optics.numerical_aperture", "optics.medium_index")
    return "depth of field of the objective", format_length(depth), depth, "µm", rests
