"""The lenslet lattice of an image: where the lenslets are, of which type, how bright, and what each one sees.

- ``fit``: the lattice from a white image; ``_spectrum``, ``_rounds``, ``_forms`` and ``_micro_image`` are its steps
- ``lattice_file``: a measured lattice as files
- ``lens_types``: which lenslet is of which type
- ``vignetting``: the fall of light over the field; ``_smooth_field`` is its model
- ``micro_images``: what views ask of a lattice, and the lattice of a camera description, of a crop, of one lens type
- ``views``: sub-aperture views; ``_view_grid`` defines where their samples lie and which lenslets contribute to them
- ``view_files``: views and focal stacks as files
- ``_refocus``: images focused at a depth, from views
- ``rendering``: the same for lenslets focused on the scene, lens types by their sharpness, and all in focus
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.lattice._face import *  # noqa: F403
    from lfcal.lattice._shared import *  # noqa: F403

lazy_face(__name__)
