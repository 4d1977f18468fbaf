"""Readers for camera descriptions of other programs. Each module recognises its format by the text of a file.

- ``camera_format``: the interface of a reader, functions that readers share, and the choice of the reader for a file,
  including readers from other packages
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
