"""Physical effects as objects. An ideal camera is the empty tuple of effects.

An effect is one class in one module, which lists it in ``EFFECTS``. Other packages add effects through the entry
point group ``lfcal.effects`` (``docs/extending.md``).

- ``base``: base class of all effects
- ``outlook``: numbers shared by all a-priori estimates
- ``optics``: lens types, diffraction, the iris's shape, non-paraxial terms
- ``aberrations``: spherical aberration, coma, any Zernike terms; how they change over the field
- ``array_errors``: telecentricity; gap, rotation, pitch and tilt of the lenslet array
- ``field``: cos^4 and mechanical vignetting
- ``colour``: longitudinal colour, the lenslets' dispersion
- ``faults``: ghost images, the sensor's nonlinearity
- ``glass``: the sensor's cover glass
- ``image``: field curvature, distortion
- ``lenslets``: spherical aberration of the lenslets, and defective lenslets
- ``kernel``: a free filter of the pixels
- ``light``: finite source, bandwidth
- ``microscope``: light as a vector field, specimens of another refractive index
- ``pixels``: fill factor, response to angles, crosstalk
- ``motion``: positioning error, backlash, drift, depth error
- ``sensor``: stray light, colour filter, noise, quantisation, saturation; ``_poisson``: Poisson random numbers
- ``magnitudes``: single magnitudes of an effect, with units and sources
- ``described``: effects as text and in files
- ``registered``: all effects, found by registry
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.simulate.effects._face import *  # noqa: F403
    from lfcal.simulate.effects._shared import *  # noqa: F403

lazy_face(__name__)
