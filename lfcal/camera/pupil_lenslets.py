"""Lenslets of a Fourier light-field microscope: a few large ones in a plane conjugate to the objective's pupil."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_choice, check_length, check_number, check_tuple, check_type
from lfcal.camera.main_lens import Microscope

__all__ = ["NoLatticeError", "PupilLenslets"]

MOST_LENSLETS = 1000
"""Largest number of lenslets; published instruments have 3 to 50."""


class NoLatticeError(InputError, AttributeError):
    """Error raised for a property that only cameras with a periodic lenslet array have."""

    @classmethod
    def of(cls, name: str) -> NoLatticeError:
        """Return the error for the property whose display name is ``name``."""
        got = "a Fourier light-field microscope, whose lenslets form no lattice"
        return cls.expected(
            name,
            "a camera with a periodic lenslet array",
            got,
            "choose a camera whose lenslets form a lattice",
        )


@dataclass(frozen=True, slots=True)
class PupilLenslets:
    """Individual lenslets in a pupil plane, as in a Fourier light-field microscope (FLFM, XLFM, FIMic).

    A Fourier lens behind the native image plane images the pupil of the objective onto the lenslets. Each lenslet
    images the entire field through its part of the pupil and forms an elemental image. All points of a depth plane have
    the same pattern. The period is therefore one pixel, and each depth plane has a single pattern [1]_ [2]_ [3]_.

    Properties that only a periodic array has, such as the pitch, the period and the lens types, raise `NoLatticeError`.

    Attributes
    ----------
    lens_centres_um
        Centres (x, y) of the lenslets relative to the optical axis (µm), x to the right, y downwards.
    fourier_um
        Focal length of the Fourier lens (µm).
    gap_um
        Distance from the lenslets to the sensor (µm).
    focal_lengths_um
        Focal lengths of the lenslets (µm): one for all, or one for each lenslet.
    clear_um
        Diameter of round lenslets, or side of square lenslets (µm).
    aperture
        Shape of the lenslets: ``"round"``, or ``"square"`` with sides parallel to the rows and columns of the sensor.
    offset_um
        Intersection (x, y) of the optical axis with the sensor, relative to the sensor's centre (µm).

    References
    ----------
    .. [1] A. Llavador et al., "Resolution improvements in integral microscopy with Fourier plane recording", Opt.
       Express 24, 20792 (2016); G. Scrofani et al., "FIMic: design for ultimate 3D-integral microscopy of in-vivo
       biological samples", Biomed. Opt. Express 9, 335 (2018).
    .. [2] L. Cong et al., "Rapid whole brain imaging of neural activity in freely behaving larval zebrafish", eLife 6,
       e28158 (2017): XLFM.
    .. [3] C. Guo et al., "Fourier light-field microscopy", Opt. Express 27, 25573 (2019).

    Examples
    --------
    >>> from lfcal.camera import Microscope, PupilLenslets
    >>> lenslets = PupilLenslets(((0.0, 0.0), (2500.0, 0.0)), 150e3, 60e3, (60e3,), 2500.0)
    >>> print(lenslets.pupil_um(Microscope(20.0, 0.5)), lenslets.relay)
    7500.0 0.4
    >>> lenslets.pitch_um
    Traceback (most recent call last):
    lfcal.camera.pupil_lenslets.NoLatticeError: lenslet pitch: expected a camera with a periodic lenslet array, got
    ... choose a camera whose lenslets form a lattice
    """

    lens_centres_um: tuple[tuple[float, float], ...]
    fourier_um: float
    gap_um: float
    focal_lengths_um: tuple[float, ...]
    clear_um: float
    aperture: str = "round"
    offset_um: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check every value."""
        check_type("centres of the lenslets", self.lens_centres_um, (tuple, list))
        centres = tuple(check_tuple("centre of a lenslet (x, y) (µm)", one, 2) for one in self.lens_centres_um)
        check_number(
            "lenslets", len(centres), at_least=1, at_most=MOST_LENSLETS, remedy="list the centre of each lenslet"
        )
        if len(set(centres)) < len(centres):
            raise InputError.expected(
                "centres of the lenslets",
                "a different centre for each lenslet",
                "({:g}, {:g}) µm more than once".format(*max(centres, key=centres.count)),
                "remove the repeated centre",
            )
        object.__setattr__(self, "lens_centres_um", centres)
        check_length("focal length of the Fourier lens (µm)", self.fourier_um)
        check_length("lenslet-sensor gap (µm)", self.gap_um)
        focal = check_tuple("focal lengths of the lenslets (µm)", self.focal_lengths_um)
        if len(focal) not in (1, len(centres)):
            wanted = f"one for all lenslets, or one for each of the {len(centres)}"
            raise InputError.expected(
                "focal lengths of the lenslets", wanted, len(focal), "list one focal length per lenslet"
            )
        for one in focal:
            check_length("focal length of a lenslet (µm)", one)
        object.__setattr__(self, "focal_lengths_um", focal)
        check_length("clear diameter of a lenslet (µm)", self.clear_um)
        check_choice("aperture of the lenslets", self.aperture, ("round", "square"))
        object.__setattr__(self, "offset_um", check_tuple("optical axis on the sensor (x, y) (µm)", self.offset_um, 2))

    def __getattr__(self, name: str) -> Any:
        """Raise `NoLatticeError` for attributes that only a lattice has."""
        if name.startswith("__"):
            raise AttributeError(name)
        raise NoLatticeError.of(f"lenslet {name.removesuffix('_um').replace('_', ' ')}")

    @property
    def focal_um(self) -> NDArray[np.float64]:
        """Focal length of each of the n lenslets, ``(n,)`` (µm)."""
        return np.broadcast_to(np.array(self.focal_lengths_um), len(self.lens_centres_um)).copy()

    @property
    def relay(self) -> float:
        """Magnification from the native image plane to the sensor: gap divided by the Fourier lens's focal length."""
        return self.gap_um / self.fourier_um

    @property
    def clear_diameter_um(self) -> float:
        """Clear diameter of a round lenslet, or side of a square lenslet (µm)."""
        return self.clear_um

    @property
    def tilt_rad(self) -> float:
        """Angle (rad) of the lenslet rows from a sensor axis: 0, because there are no rows."""
        return 0.0

    @property
    def spacing_um(self) -> float:
        """Smallest distance between the centres of two lenslets (µm); infinite for a single lenslet."""
        if len(self.lens_centres_um) == 1:
            return math.inf
        centres = np.array(self.lens_centres_um)
        apart = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
        return float(apart[~np.eye(len(centres), dtype=bool)].min())

    def pupil_um(self, optics: Microscope) -> float:
        """Return the diameter (µm) of the image of the objective's pupil in the plane of the lenslets: 2 NA f / M.

        NA and M are the numerical aperture and the magnification of ``optics``; f is the focal length of the Fourier
        lens.
        """
        return 2 * optics.numerical_aperture * self.fourier_um / optics.magnification

    def spread(self, optics: Microscope, z_um: float) -> float:
        """Return the relative radial displacement of the spots of a point at the depth ``z_um`` (µm); 0 in focus.

        A lenslet at c forms its spot at c (1 + spread), both relative to the optical axis. In the paraxial
        approximation, the spread is ``-z gap M² / (n f²)``, with the magnification M, the medium index n and the focal
        length f of the Fourier lens. It is negative beyond the focal plane, because the wave in the pupil then
        converges.
        """
        return -z_um * self.gap_um * (optics.magnification / self.fourier_um) ** 2 / optics.medium_index

    def lenslets_within(
        self, half_width_um: float, half_height_um: float, about_um: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return centres (x, y), ``(n, 2)`` (µm), and types, ``(n,)``, of elemental images in a box about ``about_um``.

        All types are 0. The box extends from the point ``about_um`` (x, y) by ``half_width_um`` to the left and to the
        right, and by ``half_height_um`` up and down. All coordinates are in µm relative to the sensor's centre.
        """
        centres = np.array(self.lens_centres_um) + np.array(self.offset_um)
        inside = (np.abs(centres - np.array(about_um)) <= (half_width_um, half_height_um)).all(-1)
        return centres[inside], np.zeros(int(inside.sum()), np.intp)

    def local(self, about_um: tuple[float, float]) -> PupilLenslets:
        """Return this object, because the lenslets are the same for every point ``about_um`` of the field."""
        del about_um
        return self
