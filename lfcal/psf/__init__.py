"""The PSF matrix H.

- ``matrix``: `PSFMatrix`, lazy, with its transposed view; ``_planes`` is where its values come from, ``facts`` what is
  known of its positions, ``_travel`` how it goes to another process
- ``make``: the one way a matrix is made of planes, whatever they come from: in memory, in a file, in units of a plane
- ``saving``: a matrix written again, transposed, within a tolerance, or with those of other regions
- ``opening``, ``store``, ``layout``: the H file; ``_chunk_codec`` compresses it on all processors, ``_nexus`` tells
  viewers what to plot; ``_steps`` stores it within a tolerance
- ``_specification``, ``_json_schema``: an H file held against the published schema of its format
- ``cutout``, ``assembly``, ``_pedestal``: frames to H with the shifting cutout
- ``picked``: patterns of a few positions, no other frame read
- ``orientation``, ``_spot_path``: which way the frames of a scan lie, from where the pattern is in some of them
- ``_transpose``: HT, one slice of it, depth-plane sums
- ``_verify``: is a file still what was written?
- ``aperture``: the shape of the iris; `lfcal.judge` says whether H is good
- ``_export``, ``_matlab``, ``lens_centre``, ``_tiff_export``: H for other programs
- ``mat_import``, ``_rearranged``, ``_lfc_import``, ``_plain_pickle``: theirs for lfcal
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.psf._face import *  # noqa: F403
    from lfcal.psf._shared import *  # noqa: F403

lazy_face(__name__)
