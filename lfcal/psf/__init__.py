"""The PSF matrix H.

- ``matrix``: `PSFMatrix`, read lazily, with its transposed view; ``_planes`` provides its values, ``facts`` what is
  known about its positions, ``_travel`` sends it to another process
- ``make``: make a matrix from planes of any source: in memory, in a file, or in units of a plane
- ``saving``: write a matrix unchanged, transposed, within a tolerance, or together with other regions
- ``opening``, ``store``, ``layout``: the H file; ``_chunk_codec`` compresses it on all processors, ``_nexus`` lets
  viewers plot it, ``_steps`` stores it within a tolerance
- ``_specification``, ``_json_schema``: check an H file against the published schema of its format
- ``cutout``, ``assembly``, ``_pedestal``: frames to H with the shifting cutout
- ``picked``: patterns of a few positions, without reading the other frames
- ``orientation``, ``_spot_path``: orientation of the frames of a scan, from the position of the pattern in some of them
- ``upright``: check of the orientation that the user states, or choice of the one that is found
- ``measured_noise``, ``denoising``: noise of the frames, and its reduction in patterns
- ``filling``, ``half_cell``, ``light``: missing, copied and dark positions; ``voxels``: sizes of pixels and voxels
- ``provenance``: facts about frames, simulation and quality from the provenance of H
- ``_transpose``: HT, a single slice of it, and depth-plane sums
- ``_verify``: check that a file has not changed
- ``aperture``: the shape of the iris (see `lfcal.judge` for the quality of H)
- ``_export``, ``codes``, ``_matlab``, ``lens_centre``, ``_tiff_export``: export H to other programs
- ``mat_import``, ``_rearranged``, ``_lfc_import``, ``_plain_pickle``: import H from other programs
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.psf._face import *  # noqa: F403
    from lfcal.psf._shared import *  # noqa: F403

lazy_face(__name__)
