"""``lfcal camera show``: show the values of a camera, their sources, and derived quantities."""

from __future__ import annotations

from lfcal.cli._console import print_json
from lfcal.cli._options import CameraArgument, JsonOption
from lfcal.tasks import load_camera


def command(camera: CameraArgument, *, json: JsonOption = False) -> None:
    """Show a camera: each value with its mark (stated, measured, derived or assumed), and derived quantities.

    Example: `lfcal camera show r29_calibration.xml`
    """
    from lfcal.cli.camera import as_json, print_camera

    found = load_camera(camera)
    print_json(as_json(found)) if json else print_camera(found)
