"""What a shell offers for the values of options and arguments; it offers files by itself where no name fits."""

from __future__ import annotations

from collections.abc import Callable, Iterable

__all__ = [
    "complete_camera",
    "complete_compression",
    "complete_mat_order",
    "complete_orientation",
]


def _among(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return a completion among names that are looked up when they are asked for."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _presets() -> Iterable[str]:
    from lfcal.camera import PRESETS

    return PRESETS


def _compressions() -> Iterable[str]:
    from lfcal.psf import COMPRESSIONS

    return COMPRESSIONS


def _mat_orders() -> Iterable[str]:
    from lfcal.psf import MAT_ORDERS

    return MAT_ORDERS


def _orientations() -> Iterable[str]:
    from lfcal.frames import ORIENTATIONS
    from lfcal.psf import AUTO, CHECK

    return (CHECK, AUTO, *(one.option for one in ORIENTATIONS.values()))


complete_camera = _among(_presets)
complete_compression = _among(_compressions)
complete_mat_order = _among(_mat_orders)
complete_orientation = _among(_orientations)
