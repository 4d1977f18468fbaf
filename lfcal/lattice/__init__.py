"""The lenslet lattice of an image: where the lenslets are, of which type, how bright, and what each one sees.

- ``fit``: the lattice from a white image; ``spectrum``, ``rounds``, ``model``, ``micro_image`` are its steps,
  ``mosaic`` what it does of colour filters
- ``lens_types``: which lenslet is of which type
- ``vignetting``: the fall of light over the field; ``smooth_field`` is its model
- ``micro_images``: what views ask of a lattice, and the lattice of a camera description, of a crop, of one lens type
- ``views``: sub-aperture views; ``view_grid`` and ``view_cells`` say where their samples lie and which lenslets make
  them, ``view_samples`` is the one extractor
- ``refocus``: images focused at a depth, from views
- ``rendering``: the same for lenslets focused on the scene, lens types by their sharpness, and all in focus
"""

from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.lens_types import LensTypes, classify_lens_types, expected_blur
from lfcal.lattice.micro_images import FrameLattice, MicroImageLattice, TypeLattice, cropped, lattice_of, type_lattice
from lfcal.lattice.refocus import refocus, sensor_slope
from lfcal.lattice.rendering import RenderedPlanes, render, sharpness_shares, total_focus
from lfcal.lattice.view_grid import ViewGrid, view_grid
from lfcal.lattice.view_samples import sample_views
from lfcal.lattice.views import Views, extract_views
from lfcal.lattice.vignetting import Vignetting, vignetting_map

__all__ = [
    "FrameLattice",
    "LatticeFit",
    "LensTypes",
    "MicroImageLattice",
    "RenderedPlanes",
    "TypeLattice",
    "ViewGrid",
    "Views",
    "Vignetting",
    "classify_lens_types",
    "cropped",
    "expected_blur",
    "extract_views",
    "fit_lattice",
    "lattice_of",
    "refocus",
    "render",
    "sample_views",
    "sensor_slope",
    "sharpness_shares",
    "total_focus",
    "type_lattice",
    "view_grid",
    "vignetting_map",
]
