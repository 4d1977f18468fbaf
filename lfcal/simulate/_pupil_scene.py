"""One depth plane of a Fourier light-field microscope as its engine needs it.

The objective and the tube lens image a point at depth z into the native image plane. The Fourier lens turns that image
into the objective's pupil, on the lenslets. With the position u on the lenslets, f the focal length of the Fourier lens
and sin t = M |u| / (n f) (sine condition), the field there is the Debye pupil function [1]_ [2]_

    U(u) = (cos t)^-1/2 exp(i k n z (cos t - 1)) exp(i k u.s),        |u| <= NA f / M,

z > 0 away from the objective, where the wave converges. s is the slope of the chief ray: B s is the distance of the
source's image from the axis on the sensor, B behind the lenslets. The amplitude is that of an isotropic scalar point
behind an aplanatic objective, the same as in the Debye integral of `lfcal.simulate.engines`.

Coordinates are those of `lfcal.simulate.scene`: the sensor's origin is the chief ray of source position (0, 0).

References
----------
.. [1] C. Guo et al., "Fourier light-field microscopy", Opt. Express 27, 25573 (2019), section 2.2.
.. [2] M. Broxton et al., "Wave optics theory and 3-D deconvolution for the light field microscope", Opt. Express 21,
   25418 (2013), eq. 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_cutout, check_number, check_wavelength
from lfcal.camera import Microscope, PupilLenslets
from lfcal.simulate.scene import Scene

__all__ = ["AnyScene", "PupilScene"]

F8 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PupilScene:
    """All inputs of the engine for one depth plane; lengths in µm.

    Attributes
    ----------
    wavelength_um, pixel_um
        Wavelength in air, and pixel pitch.
    lenslets, objective
        The lenslets, and the microscope in front of them.
    z_um
        Depth of the source, positive away from the objective.
    cutout, period
        Pixels (nt, ns) around each source position; number of source positions (ny, nx) of a full plane.
    axis_um
        Point where the optical axis meets the sensor, ``(y, x)`` relative to the chief ray of position (0, 0).
    pixel_fill
        Light-sensitive fraction of a pixel's side, in (0, 1].
    offsets_um
        Displacement ``(ny, nx, 2)`` as (dy, dx) of each source position on the sensor's scale, or None.
    """

    wavelength_um: float
    pixel_um: float
    lenslets: PupilLenslets
    objective: Microscope
    z_um: float
    cutout: tuple[int, int]
    period: tuple[int, int]
    axis_um: tuple[float, float] = (0.0, 0.0)
    pixel_fill: float = 1.0
    offsets_um: F8 | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Check every value."""
        check_wavelength(self.wavelength_um)
        check_number("pixel pitch (µm)", self.pixel_um, above=0)
        check_number("light-sensitive fraction of a pixel's side", self.pixel_fill, above=0, at_most=1)
        check_cutout(*self.cutout)

    # -- light on the lenslets ---------------------------------------------------------------------------
    @property
    def pupil_radius_um(self) -> float:
        """Radius of the pupil on the lenslets (µm)."""
        return self.lenslets.pupil_um(self.objective) / 2

    def cosine(self, square_um2: F8) -> F8:
        """Return cos t at squared distances from the axis (µm²); that of the pupil's edge beyond it."""
        n = self.objective.medium_index
        sine2 = (
            np.minimum(square_um2, self.pupil_radius_um**2)
            * (self.objective.magnification / (n * self.lenslets.fourier_um)) ** 2
        )
        return np.sqrt(1 - sine2)

    def field(self, y: F8, x: F8) -> NDArray[np.complex128]:
        """Return the field of an on-axis source at points (y, x) of one shape; unit energy over the pupil."""
        n, z = self.objective.medium_index, self.z_um
        cosine = self.cosine(y * y + x * x)
        sine_edge = self.objective.numerical_aperture / n
        # the integral of 1/cos t over the pupil: 2 pi (1 - cos alpha) (n f / M)²
        solid = 2 * math.pi * sine_edge**2 / (1 + math.sqrt(1 - sine_edge**2))
        area = solid * (n * self.lenslets.fourier_um / self.objective.magnification) ** 2
        # cos t - 1 without cancellation
        path = -n * z * (1 - cosine * cosine) / (1 + cosine)
        out: NDArray[np.complex128] = np.exp(2j * np.pi / self.wavelength_um * path) / np.sqrt(cosine * area)
        return out

    def slope(self, y: float, x: float) -> tuple[float, float]:
        """Return the slope of an on-axis source's wave at a point of the pupil, or at its edge in that direction."""
        radius = math.hypot(y, x)
        inside = min(1.0, self.pupil_radius_um / radius) if radius else 1.0
        rate = self.objective.magnification / (self.objective.medium_index * self.lenslets.fourier_um)
        cosine = float(self.cosine(np.array(radius * radius)))
        bend = -self.objective.medium_index * self.z_um * rate * rate * inside / cosine
        return bend * y, bend * x

    @property
    def image_map(self) -> None:
        """Displacement of images: none is simulated."""
        return

    # -- positions ---------------------------------------------------------------------------------------
    def nearest_pixel(self, y_um: float, x_um: float) -> tuple[int, int]:
        """Return the pixel (row, column), relative to source position (0, 0), that a chief ray meets."""
        return math.floor(y_um / self.pixel_um + 0.5), math.floor(x_um / self.pixel_um + 0.5)

    def source_um(self, y: int, x: int) -> tuple[float, float]:
        """Return the sensor point (y, x) that the chief ray of position (y, x) meets, including its offset (µm)."""
        dy, dx = (0.0, 0.0) if self.offsets_um is None else self.offsets_um[y % self.period[0], x % self.period[1]]
        return y * self.pixel_um + float(dy), x * self.pixel_um + float(dx)

    def imaged_um(self, y_um: float, x_um: float) -> tuple[float, float]:
        """Return the sensor point (y, x) that a chief ray meets, which is the paraxial point (µm)."""
        return y_um, x_um


AnyScene = Scene | PupilScene
"""What an engine computes: a plane behind a lenslet lattice, or behind single lenslets in a pupil plane."""
