"""Where the page Reconstruct may compute: on an accelerator, where there is one that can be used. No Qt."""

from __future__ import annotations

from lfcal_gui.models import Field

__all__ = ["DEVICE", "NO_DEVICE", "device_reason"]

DEVICE = Field(
    "device",
    "Device",
    kind="choice",
    choices=(("auto", "auto"), ("cpu", "cpu: processor"), ("cuda", "cuda: accelerator")),
    tip="Where H is applied; auto takes an accelerator that has room and is told to be quicker, else the processor",
)

NO_DEVICE = (
    "Greyed out: this machine has no accelerator that PyTorch or CuPy can use, so all is computed on the processor. "
    "With a graphics card, install torch or cupy and array-api-compat."
)


def device_reason() -> str:
    """Return why no accelerator can be chosen here, empty where one can; libraries are loaded, so it may take seconds.

    One that computes wrongly counts as none.
    """
    from lfcal.reconstruct.projectors import find_device

    # a machine without a driver loads no library for it
    return "" if find_device("auto") is not None else NO_DEVICE
