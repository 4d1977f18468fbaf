"""The shape of the main lens's iris, read off a depth-plane sum.

- ``shape``: the iris polygon with curved blades; the `Aperture` that a fit returns
- ``_arcs``: outlines made of arcs: irises, a stuck blade, a second rim
- ``_locate``: background, noise and rough outline of the lit patch; vignetting taken out
- ``_profile``: edge radius over angle, summed along rays so that it survives noise
- ``_ripple``: the plane waves of the lenslet lattice, fitted inside the lit patch and taken out
- ``_obstruction``: something dark inside
- ``_edge``: the edge's harmonics with their errors, those of leftover structure included, and their blur
- ``_compare``: least squares of every shape on the harmonics
- ``_verdict``: which shape it is, by likelihood ratios
- ``fit``: `fit_aperture`, and when it refuses
- ``iris``: one iris from all planes
- ``expected``: the aperture that a camera's description lets expect
- ``f_number``: working f-number from diameters over depth
- ``_synthetic``: depth-plane sums of a known iris
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.psf.aperture._face import *  # noqa: F403
    from lfcal.psf.aperture._shared import *  # noqa: F403

lazy_face(__name__)
