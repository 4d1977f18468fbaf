"""The lenslet lattice in an image: positions, types and brightness of lenslets, and views through them.

- ``fit``: fitting of the lattice to a white image; ``_spectrum``, ``_rounds``, ``_forms`` and ``_micro_image`` are its
  steps
- ``lattice_file``: a measured lattice as files
- ``lens_types``: the type of each lenslet
- ``vignetting``: the fall-off of light over the field; ``_smooth_field`` is its model
- ``micro_images``: the lattice interface that views need; lattices of a camera description, of a part of the sensor,
  and of one lens type
- ``views``: sub-aperture views; ``_view_grid`` defines the positions of their samples and the lenslets that contribute
- ``view_files``: views and focal stacks as files
- ``_refocus``: refocused images from views
- ``rendering``: refocused images of a focused plenoptic camera, weighting lens types by sharpness, and all-in-focus
  images
- ``depth``: depth maps from micro-images or views; its parts are ``_depth_kernels``, ``_depth_views`` and
  ``_depth_map``
- ``elemental_depth``: depth maps from the elemental images of a Fourier light-field microscope
- ``depth_files``: depth maps and point clouds as files
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.lattice._face import *  # noqa: F403
    from lfcal.lattice._shared import *  # noqa: F403

lazy_face(__name__)
