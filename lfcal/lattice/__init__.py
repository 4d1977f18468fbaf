"""The lenslet lattice of an image: where the lenslets are, of which type, how bright, and what each one sees.

- ``fit``: the lattice from a white image; ``spectrum``, ``rounds``, ``model``, ``micro_image`` are its steps
- ``lens_types``: which lenslet is of which type
- ``vignetting``: the fall of light over the field; ``smooth_field`` is its model
- ``views``: sub-aperture views and refocused images; ``view_grid`` says which lenslets make their pixels
"""

from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.lens_types import LensTypes, classify_lens_types, expected_blur
from lfcal.lattice.view_grid import ViewGrid, view_grid
from lfcal.lattice.views import Views, extract_views, refocus, sensor_slope
from lfcal.lattice.vignetting import Vignetting, vignetting_map

__all__ = [
    "LatticeFit",
    "LensTypes",
    "ViewGrid",
    "Views",
    "Vignetting",
    "classify_lens_types",
    "expected_blur",
    "extract_views",
    "fit_lattice",
    "refocus",
    "sensor_slope",
    "view_grid",
    "vignetting_map",
]
