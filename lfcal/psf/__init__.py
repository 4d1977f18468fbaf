"""The PSF matrix H.

- ``matrix``: `PSFMatrix`, lazy, with its transposed view; ``planes`` is where its values come from, ``facts`` what is
  known of its positions, ``travel`` how it goes to another process
- ``make``: the one way a matrix is made of planes, whatever they come from: in memory, in a file, in units of a plane
- ``saving``: a matrix written again, transposed, within a tolerance, or with those of other regions
- ``opening``, ``store``, ``layout``: the H file; ``chunk_codec`` compresses it on all processors, ``nexus`` tells
  viewers what to plot; ``steps`` stores it within a tolerance
- ``specification``, ``json_schema``: an H file held against the published schema of its format
- ``cutout``, ``gather``, ``assembly``, ``pedestal``: frames to H with the shifting
  cutout
- ``picked``: patterns of a few positions, no other frame read
- ``orientation``, ``spot_path``: which way the frames of a scan lie, from where the pattern is in some of them
- ``transpose``: HT, one slice of it, depth-plane sums
- ``verify``: is a file still what was written?
- ``aperture``, ``quality``, ``compare``, ``report``: is it any good?
- ``export``, ``matlab``, ``lens_centre``, ``tiff_export``: H for other programs
- ``mat_import``, ``rearranged``, ``lfc_import``, ``plain_pickle``: theirs for lfcal
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.psf._face import *  # noqa: F403
    from lfcal.psf._shared import *  # noqa: F403

lazy_face(__name__)
