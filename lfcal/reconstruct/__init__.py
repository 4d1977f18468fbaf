"""Volume reconstruction: the projector pair and the solvers.

- ``projectors``: `Projector`, the pair, its methods, and the cost of each on this machine
- ``solvers``: one module each, found by name
- ``phantoms``, ``resolution``: synthetic volumes, and the quality of their reconstruction
- ``resample``: resampling of light fields to whole periods; ``metric_grid``: volumes with one voxel size
- ``series``, ``volumes``: many frames, and results as files; ``memory``: memory required
- ``frame_run``: from files of frames to files of volumes, optionally in units (``_frame_units``); ``frame_files``: the
  frames; ``optics``: shared settings and H
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.reconstruct._face import *  # noqa: F403
    from lfcal.reconstruct._shared import *  # noqa: F403

lazy_face(__name__)
