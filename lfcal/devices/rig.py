"""The devices of a session: camera, stage, light, clock and gauges."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from lfcal.devices.checked import CheckedCamera, CheckedLight, CheckedStage
from lfcal.devices.errors import DeviceError, driver_errors
from lfcal.devices.protocols import CameraDevice, Gauge, Light, StageDevice, SystemTime, TimeSource

__all__ = ["FileGauge", "Rig"]


@dataclass(frozen=True, slots=True)
class Rig:
    """Camera, stage and, if it can be switched, light source; as a context manager, the rig is closed at the end.

    Every call of a camera, stage or light source that waits in real time has a time limit; a call that exceeds it
    raises `DeviceLost`. The answers of camera and stage are checked; see `lfcal.devices.checked`. ``time`` is the
    clock. ``others`` are devices that were opened together with these, and are closed with them. ``gauges`` measure the
    conditions in the lab. ``switches`` states whether the stage's moves switch the points of a display, as in a
    simulator.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import Rig, simulated_rig
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> rig: Rig
    >>> with simulated_rig(plan) as rig:  # camera and stage are released at its end
    ...     rig.stage.move((100.0, -50.0, 0.0))
    ...     rig.time.sleep(10.0)
    ...     print([round(um) for um in rig.stage.position()])
    [100, -50, 0]
    """

    camera: CameraDevice
    stage: StageDevice
    light: Light | None = None
    time: TimeSource = field(default_factory=SystemTime)
    others: tuple[CameraDevice | StageDevice, ...] = ()
    gauges: tuple[Gauge, ...] = ()
    switches: bool = False

    def __post_init__(self) -> None:
        """Wrap the devices in their checks."""
        object.__setattr__(self, "camera", CheckedCamera.of(self.camera))
        object.__setattr__(self, "stage", CheckedStage.of(self.stage))
        if self.light is not None:
            object.__setattr__(self, "light", CheckedLight.of(self.light))

    def close(self) -> None:
        """Release the cameras and stages, even if one of them fails.

        A device whose driver still hangs in an earlier call is not released, and no error is raised for it.

        Raises
        ------
        DeviceError
            If releasing a device fails or takes too long.
        """
        with ExitStack() as stack:
            for device in (self.camera, *self.others, self.stage):
                stack.callback(_release, device)

    def __enter__(self) -> Rig:
        """Return the rig."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the rig."""
        self.close()


def _release(device: CameraDevice | StageDevice) -> None:
    with driver_errors(device.name):
        device.close()


TAIL_BYTES = 4096
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class FileGauge:
    """Gauge that reads the last number in the last complete line of a text file to which a logger appends.

    Parameters
    ----------
    path
        The file; of a line such as ``2026-05-04 12:00:03, 21.37``, the reading is 21.37.
    """

    unit = ""

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.name

    def read(self) -> float:
        """Return the last number; raise `DeviceError` if the line has none, or the file cannot be read."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                file.seek(max(0, size - TAIL_BYTES))
                text = file.read().decode("utf-8", "replace")
        except OSError as error:
            raise DeviceError(f"{self.path}: cannot be read ({error.strerror or error}); check the path") from error
        # a line without a line end may be incomplete
        lines = [line for line in text[: text.rfind("\n") + 1].splitlines() if line.strip()]
        found = NUMBER.findall(lines[-1]) if lines else []
        if not found:
            raise DeviceError.expected(
                str(self.path), "a last line with a number", "none", ("check the program that writes it")
            )
        return float(found[-1])
