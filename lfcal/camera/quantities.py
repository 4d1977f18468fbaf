"""Values that describe a camera: label, unit, and usual limits of each."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

from lfcal.camera.description import Camera
from lfcal.camera.lattice import LensletLattice
from lfcal.camera.pupil_lenslets import PupilLenslets

__all__ = ["QUANTITIES", "Quantity", "has_value", "quantities_of", "value_at"]

CENTRES = "lattice.lens_centres_um"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Definition of one value of a camera description: its path, unit, limits and display.

    Attributes
    ----------
    path
        Path in the description, such as ``"sensor.pixel_um"``.
    label, unit
        Display name and displayed unit.
    scale
        Factor between units: displayed value = value in the description / scale. For example, 1000 displays µm as mm.
    usual
        Usual limits (lower, upper) in the unit of the description; a value outside them probably has a wrong unit.
        None: no limits.
    option
        Command-line option that sets the value; empty if only ``--set`` does.
    light
        Whether the value affects only light and noise, and not the geometry of images.
    empty, meaning
        Text displayed in place of a missing value, and text displayed after a value.

    Examples
    --------
    >>> from lfcal.camera import QUANTITIES, Quantity
    >>> quantity: Quantity = next(one for one in QUANTITIES if one.path == "optics.focal_length_um")
    >>> print(f"{quantity.label}: {quantity.text(200e3)}, usually {quantity.text(quantity.usual[1])} at most")
    focal length of the main lens: 200 mm, usually 3000 mm at most
    """

    path: str
    label: str
    unit: str = ""
    scale: float = 1.0
    usual: tuple[float, float] | None = None
    option: str = ""
    light: bool = False
    empty: str = "none"
    meaning: str = ""

    def text(self, value: Any) -> str:
        """Return ``value`` (in the unit of the description) as text in the displayed unit; `empty` if missing."""
        if value is None or value == "":
            return self.empty
        if self.path == "sensor.shape":
            return f"{value[0]} x {value[1]} {self.unit}"
        if self.path == CENTRES:
            return "; ".join(f"{x:.6g}, {y:.6g}" for x, y in value) + f" {self.unit}"
        parts = value if isinstance(value, tuple) else (value,)
        shown = ", ".join(part if isinstance(part, str) else f"{part / self.scale:.6g}" for part in parts)
        return f"{shown} {self.unit}".rstrip() + (f", {self.meaning}" if self.meaning else "")


LENS = "--lens FOCAL,F_NUMBER,DISTANCE"
OBJECTIVE = "--objective MAGNIFICATION,NA,INDEX"
SENSOR = "--sensor ROWSxCOLUMNS,PIXEL"

CLEAR = "lattice.clear_um"
UNSTATED = {"square": "squares without gaps", "hexagonal": "round, as wide as the pitch"}
"""Shape of lenslets without a stated clear diameter, by the kind of array; others are round, within their cells."""
FULL = "; ".join(f"{kind}: {words}" for kind, words in UNSTATED.items())

QUANTITIES = (
    Quantity("optics.focal_length_um", "focal length of the main lens", "mm", 1e3, (1e3, 3e6), option=LENS),
    Quantity("optics.f_number", "f-number of the main lens", usual=(0.5, 64), option=LENS),
    Quantity("optics.working_distance_um", "distance to the working plane", "mm", 1e3, (2e3, 1e9), option=LENS),
    Quantity("optics.blades", "iris blades", light=True),
    Quantity("optics.blade_rotation_rad", "iris rotation", "°", math.pi / 180, light=True),
    Quantity("optics.blade_curvature", "iris blade curvature", light=True),
    Quantity("optics.magnification", "magnification", "x", usual=(0.1, 300), option=OBJECTIVE),
    Quantity("optics.numerical_aperture", "numerical aperture", usual=(0.01, 1.7), option=OBJECTIVE),
    Quantity("optics.medium_index", "index of the medium", usual=(1.0, 1.8), option=OBJECTIVE),
    Quantity("optics.tube_length_um", "focal length of the tube lens", "mm", 1e3, (2e4, 1e6)),
    Quantity("lattice.kind", "lenslet array", option="--array hexagonal|square"),
    Quantity("lattice.pitch_um", "pitch of the micro-images", "µm", usual=(4.0, 5e3), option="--pitch UM"),
    Quantity("lattice.row_pitch_um", "distance between rows", "µm", usual=(4.0, 5e3)),
    Quantity("lattice.gap_um", "gap between lenslets and sensor", "µm", usual=(10.0, 5e4), option="--gap UM"),
    Quantity("lattice.types", "focal lengths of the lenslets", "µm", usual=(10.0, 5e4), option="--focus V,V,V"),
    Quantity("lattice.fourier_um", "focal length of the Fourier lens", "mm", 1e3, (1e4, 1e6)),
    Quantity("lattice.focal_lengths_um", "focal lengths of the lenslets", "mm", 1e3, (1e3, 1e6)),
    Quantity(CENTRES, "centres of the lenslets from the axis (x, y)", "µm"),
    Quantity("lattice.aperture", "aperture of the lenslets (round, square)"),
    Quantity("lattice.rotation_rad", "rotation of the array", "°", math.pi / 180),
    Quantity("lattice.shear_rad", "shear of the array", "°", math.pi / 180),
    Quantity("lattice.offset_um", "centre of a type-0 micro-image (x, y)", "µm"),
    Quantity(CLEAR, "clear diameter of a lenslet, as seen on the sensor", "µm", usual=(4.0, 5e3), empty=FULL),
    Quantity("lattice.type_step", "lens type next to type 0 in a row"),
    Quantity("sensor.shape", "sensor (rows x columns)", "px", option=SENSOR),
    Quantity("sensor.pixel_um", "pixel pitch", "µm", usual=(0.4, 60.0), option=SENSOR),
    Quantity("sensor.bit_depth", "bit depth", "bit", light=True),
    Quantity("sensor.full_well_e", "full well", "e-", usual=(200.0, 1e7), light=True),
    Quantity("sensor.read_noise_e", "read noise", "e- rms", light=True),
    Quantity("sensor.dark_current_e_s", "dark current", "e-/s", light=True),
    Quantity("sensor.black_level", "black level", "counts", light=True),
    Quantity("sensor.prnu", "pixel response non-uniformity", usual=(0.0, 0.2), light=True),
    Quantity("sensor.quantum_efficiency", "quantum efficiency", light=True),
    Quantity("sensor.fill_factor", "fill factor of a pixel", light=True),
    Quantity("sensor.saturation", "saturation", "counts", light=True),
    Quantity("sensor.dsnu_e", "dark signal non-uniformity", "e-", light=True),
    Quantity("sensor.linearity", "deviation from linearity", light=True),
    Quantity("sensor.cfa", "colour filter", light=True),
    Quantity("wavelength_um", "wavelength", "nm", 1e-3, (0.2, 3.0), option="--wavelength NM", light=True),
    Quantity("bandwidth_um", "bandwidth", "nm", 1e-3, light=True),
)
"""Every value that a user can state, in display order."""

_PATHS = frozenset(quantity.path for quantity in QUANTITIES)

IN_A_PUPIL: dict[str, dict[str, Any]] = {
    "lattice.gap_um": {"usual": (1e3, 1e6)},
    "lattice.offset_um": {"label": "optical axis on the sensor (x, y)"},
    CLEAR: {"label": "diameter of a lenslet", "usual": (100.0, 5e4), "empty": "none"},
}
"""Attributes of quantities that differ for lenslets in a pupil plane."""

UNLESS: dict[str, object] = {
    "lattice.row_pitch_um": None,
    "lattice.shear_rad": 0.0,
    "sensor.saturation": None,
    "sensor.dsnu_e": None,
    "sensor.linearity": None,
}
"""Values that are displayed only if they differ from these."""


@cache
def _names(kind: Any) -> frozenset[str]:
    return frozenset(field.name for field in fields(kind))


def has_value(camera: Camera, path: str) -> bool:
    """Return whether the description of ``camera`` has a value at ``path``.

    A value that is displayed only if it differs from its default counts as missing if it equals the default. The type
    step of a lattice with a single lens type also counts as missing.

    Examples
    --------
    >>> from lfcal.camera import has_value, preset
    >>> print([has_value(preset(name), "optics.f_number") for name in ("r29", "lfm_20x05")])
    [True, False]
    """
    if path not in _PATHS:
        return False
    part, _, name = path.rpartition(".")
    held = getattr(camera, part) if part else camera
    kind: Any = type(held)
    if name not in _names(kind):
        return False
    # rows at their ideal distance, and values that were not measured, are not displayed
    given = path not in UNLESS or getattr(held, name) != UNLESS[path]
    return given and not (path == "lattice.type_step" and len(camera.lattice.types) == 1)


def quantities_of(camera: Camera) -> tuple[Quantity, ...]:
    """Return the definitions of all values that `has_value` finds in the description of ``camera``.

    Examples
    --------
    >>> from lfcal.camera import preset, quantities_of, value_at
    >>> camera = preset("lfm_60x12")
    >>> for quantity in quantities_of(camera)[:4]:
    ...     print(f"{quantity.label}: {quantity.text(value_at(camera, quantity.path))}")
    magnification: 60 x
    numerical aperture: 1.2
    index of the medium: 1.35
    focal length of the tube lens: 200 mm
    """
    found = (quantity for quantity in QUANTITIES if has_value(camera, quantity.path))
    lattice = camera.lattice
    if isinstance(lattice, PupilLenslets):
        return tuple(replace(quantity, **IN_A_PUPIL.get(quantity.path, {})) for quantity in found)
    return tuple(_fitting(quantity, lattice) if quantity.path == CLEAR else quantity for quantity in found)


def _fitting(quantity: Quantity, lattice: LensletLattice) -> Quantity:
    """Return the quantity of the clear diameter with a text that states its meaning in this array."""
    shape = "without gaps" if lattice.gapless else "round"
    if not lattice.gapless and lattice.clear_diameter_um > lattice.cell_um[0]:
        shape = "round, cut off where the next lenslet begins"
    return replace(quantity, meaning=shape, empty=UNSTATED[lattice.kind])


def value_at(camera: Camera, path: str) -> Any:
    """Return the value at ``path`` in the description of ``camera``; for lens types, their focal lengths (µm).

    Examples
    --------
    >>> from lfcal.camera import preset, value_at
    >>> camera = preset("bench")
    >>> print(value_at(camera, "sensor.shape"), [round(f) for f in value_at(camera, "lattice.types")])
    (320, 320) [581, 436, 363]
    """
    if path == "lattice.types":
        return tuple(kind.focal_length_um for kind in camera.lattice.types)
    found: Any = camera
    for name in path.split("."):
        found = getattr(found, name)
    return found
