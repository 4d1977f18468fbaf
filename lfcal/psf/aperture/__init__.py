"""The shape of the main lens's iris, read off a depth-plane sum.

- ``shape``: the iris polygon with curved blades; the `Aperture` that a fit returns
- ``locate``: background, noise and rough outline of the lit patch; vignetting taken out
- ``profile``: edge radius over angle, summed along rays so that it survives noise
- ``select``: how many blades, by comparing harmonic combs
- ``refine``: least squares on pixels
- ``fit``: `fit_aperture`, and when it refuses
- ``f_number``: working f-number from diameters over depth
- ``synthetic``: depth-plane sums of a known iris
"""

from lfcal.psf.aperture.f_number import FNumber, working_f_number
from lfcal.psf.aperture.fit import fit_aperture
from lfcal.psf.aperture.shape import Aperture

__all__ = ["Aperture", "FNumber", "fit_aperture", "working_f_number"]
