"""Descriptions of cameras that others wrote, one module a format: each says by a file's text whether it can read it.

- ``camera_format``: what a format must provide, how its values are read, and the format of a file, found among these
  modules and those of other packages
- ``lfcal_json``: lfcal's own camera.json
- ``raytrix_xml``: the calibration file of a Raytrix camera, and its grid of lenses
- ``olaf_yaml``: configuration of oLaF and pyolaf
- ``napari_lf``: metadata of napari-LF
- ``micro_manager``: system configuration and metadata of Micro-Manager
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.camera.importers._face import *  # noqa: F403
    from lfcal.camera.importers._shared import *  # noqa: F403

lazy_face(__name__)
