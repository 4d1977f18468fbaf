"""Switch the light of the source: off for dark frames, on for all others."""

from __future__ import annotations

from contextlib import suppress

from lfcal.acquire.control import Control
from lfcal.base import InputError
from lfcal.devices import CheckedLight, Rig

__all__ = ["Lighting", "check_light"]


def check_light(rig: Rig) -> None:
    """Raise `InputError` unless the rig has a light that can be switched off for dark frames."""
    if rig.light is None:
        raise InputError.expected(
            "dark frames",
            "a light that can be switched off",
            f"none with {rig.camera.name}",
            "cover the lens when asked (--cover), or record without them (--darks 0)",
        )


class Lighting:
    """Controller that switches the light only when necessary, because a lamp that stays on is more stable.

    Parameters
    ----------
    rig, control
        The devices, and the requests of the user.
    settle_s
        Waiting time after switching the light (s).
    """

    def __init__(self, rig: Rig, control: Control, settle_s: float) -> None:
        self._light = None if rig.light is None else CheckedLight.of(rig.light)
        self._time, self._control, self._settle = rig.time, control, settle_s
        self._off = False

    def switch(self, on: bool) -> None:
        """Switch the light on or off, and wait for the settling time; do nothing if it is already in this state.

        Without a light, nothing is done. Raises `DeviceError` if switching fails, and `Aborted` if the user aborts.
        """
        if self._light is None or on != self._off:
            return
        self._off = True  # also while switching, because a fault may leave it on or off
        self._light.switch(on)
        self._off = not on
        self._control.sleep(self._settle, self._time)

    def restore(self) -> None:
        """Switch the light on again if it is off and still responds; ignore errors."""
        if self._light is not None and self._off and not self._light.hangs:
            with suppress(Exception):
                self._light.switch(True)
                self._off = False
