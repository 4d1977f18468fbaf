"""Optics in front of the lenslets: a photographic main lens or a microscope."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfcal.base import check_length, check_number

__all__ = ["MainLens", "Microscope", "Optics"]


@dataclass(frozen=True, slots=True)
class MainLens:
    """Photographic main lens, focused on the lenslet array.

    Attributes
    ----------
    focal_length_um
        Focal length (µm).
    f_number
        f-number set on the lens: focal length divided by the diameter of the entrance pupil.
    working_distance_um
        Distance from the lens to the plane that is imaged onto the lenslet array (µm).
    blades
        Number of iris blades; 0 for a circular iris.
    blade_rotation_rad
        Angle (rad) from the sensor's +x axis towards +y to the first vertex of the iris.
    blade_curvature
        Ratio of the apothem of the iris to the radius of curvature of a blade: 0 for straight edges, 1 for a circle.

    Examples
    --------
    >>> from lfcal.camera import MainLens
    >>> lens = MainLens(focal_length_um=50e3, f_number=4.0, working_distance_um=100e3)
    >>> print(round(lens.image_distance_um), round(lens.magnification, 3), round(lens.working_f_number, 3))
    100000 1.0 8.0
    """

    focal_length_um: float = 200e3
    f_number: float = 4.0
    working_distance_um: float = 1e6
    blades: int = 9
    blade_rotation_rad: float = 0.0
    blade_curvature: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_length("main lens focal length (µm)", self.focal_length_um)
        check_number("main lens f-number", self.f_number, above=0)
        check_length(
            "working distance (µm)",
            self.working_distance_um,
            # a working distance at or within the focal length has no real image on the array
            above=self.focal_length_um,
            remedy="give a distance beyond the focal length",
        )
        check_number("iris blades", self.blades, at_least=0, at_most=64, integer=True)
        # an iris needs three blades to enclose an area
        if self.blades in (1, 2):
            check_number("iris blades", self.blades, at_least=3, remedy="use 0 for a circular iris")
        check_number("blade rotation (rad)", self.blade_rotation_rad)
        check_number("blade curvature", self.blade_curvature, at_least=0, at_most=1)

    @property
    def telecentric(self) -> bool:
        """Whether the chief rays are parallel at the lenslets; always false for a main lens."""
        return False

    @property
    def image_distance_um(self) -> float:
        """Distance from the lens to the lenslet array (µm), from the thin-lens equation."""
        return self.image_of(self.working_distance_um)

    def image_of(self, object_distance_um: float) -> float:
        """Return the distance (µm) from the lens to the image of a point ``object_distance_um`` in front of it."""
        return 1.0 / (1.0 / self.focal_length_um - 1.0 / object_distance_um)

    @property
    def magnification(self) -> float:
        """Lateral magnification |M| from the working plane to the lenslet array."""
        return self.image_distance_um / self.working_distance_um

    @property
    def working_f_number(self) -> float:
        """Working f-number at the lenslets: image distance divided by pupil diameter."""
        # pupil diameter is f/N
        return self.image_distance_um * self.f_number / self.focal_length_um


@dataclass(frozen=True, slots=True)
class Microscope:
    """Infinity-corrected, telecentric light-field microscope.

    Attributes
    ----------
    magnification
        Lateral magnification |M| of objective and tube lens together.
    numerical_aperture
        Object-side numerical aperture (NA) of the objective.
    medium_index
        Refractive index of the immersion medium.
    tube_length_um
        Focal length of the tube lens (µm).

    Examples
    --------
    >>> import math
    >>> from lfcal.camera import Microscope
    >>> objective = Microscope(magnification=20.0, numerical_aperture=0.5)
    >>> print(objective.working_f_number, f"{math.degrees(objective.half_angle_rad):.1f}°")
    20.0 30.0°
    """

    magnification: float = 20.0
    numerical_aperture: float = 0.5
    medium_index: float = 1.0
    tube_length_um: float = 200e3

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("magnification", self.magnification, above=0)
        check_number("medium index", self.medium_index, at_least=1, at_most=4)
        check_number(
            "numerical aperture",
            self.numerical_aperture,
            above=0,
            below=self.medium_index,
            remedy="choose an NA below the index of the medium",
        )
        check_length("tube lens focal length (µm)", self.tube_length_um)

    @property
    def telecentric(self) -> bool:
        """Whether the chief rays are parallel at the lenslets; always true for a microscope."""
        return True

    @property
    def image_distance_um(self) -> float:
        """Distance from the exit pupil to the lenslet array (µm): infinite, because the chief rays are parallel."""
        return math.inf

    @property
    def working_f_number(self) -> float:
        """Working f-number at the lenslets: M / (2 NA), with the magnification M and the numerical aperture NA."""
        # paraxial 1/(2 NA) on the object side, M times slower on the image side
        return self.magnification / (2 * self.numerical_aperture)

    @property
    def half_angle_rad(self) -> float:
        """Half angle (rad) of the cone of light that the objective collects, in the immersion medium."""
        return math.asin(self.numerical_aperture / self.medium_index)


Optics = MainLens | Microscope
