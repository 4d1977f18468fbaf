"""Volume reconstruction: the projector pair and the solvers.

- ``projectors``: `Projector`, the pair, the ways it works, and what each costs on this machine
- ``solvers``: one module each, found by name
- ``phantoms``, ``resolution``: volumes whose truth is known, and how close a reconstruction is to it
- ``resample``: light fields onto whole periods; ``metric_grid``: voxels of one size
- ``series``, ``volumes``: many frames, results as files; ``memory``: what a reconstruction takes
- ``frame_run``: frames in files to volumes in files, in units (``_frame_units``) or not; ``frame_files``: the frames;
  ``optics``: what all of them share
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.reconstruct._face import *  # noqa: F403
    from lfcal.reconstruct._shared import *  # noqa: F403

lazy_face(__name__)
