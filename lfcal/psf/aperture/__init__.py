"""The shape of the main lens's iris, measured in a depth-plane sum.

- ``shape``: the iris polygon with curved blades; the `Aperture` that a fit returns
- ``_arcs``: outlines made of arcs: irises, a stuck blade, a second rim
- ``_locate``: background, noise and rough outline of the lit patch; removal of vignetting
- ``_profile``: edge radius over angle, summed along rays for robustness against noise
- ``_ripple``: the plane waves of the lenslet lattice, fitted inside the lit patch and removed
- ``_obstruction``: dark objects inside the aperture
- ``_edge``: harmonics of the edge with their errors, including those of residual structure, and their blur
- ``_compare``: least-squares fits of every shape to the harmonics
- ``_verdict``: choice of the shape by likelihood ratios
- ``_size``: area of the outline, from all its light
- ``fit``: `fit_aperture`, and its reasons for refusal
- ``iris``: one iris from all planes
- ``expected``: the aperture expected from a camera's description
- ``f_number``: working f-number from diameters over depth
- ``_synthetic``: depth-plane sums of a known iris
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.psf.aperture._face import *  # noqa: F403
    from lfcal.psf.aperture._shared import *  # noqa: F403

lazy_face(__name__)
