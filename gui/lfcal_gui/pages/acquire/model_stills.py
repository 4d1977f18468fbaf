"""White and dark frames of the whole sensor: taken, checked, written beside the session. No Qt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, check_writable, replace_whole
from lfcal.camera import ScanPlan
from lfcal.frames import CorrectionRecipe
from lfcal_gui.pages.acquire.model_station import Station

__all__ = ["ASKED", "KINDS", "Stills", "iter_stills", "recipe_of", "still_files"]

COUNT = 8
KINDS = (
    ("white", "White image", "Frames of an even light: lattice and fall of light are measured in them"),
    ("dark", "Dark frames", "Frames without any light, of the whole sensor: a white image needs them"),
)
"""Key, title and meaning of what can be taken."""

ASKED = {
    "white": "Put an even light, or a diffuser, before the lens, with the iris as in the session.\n"
    "The live view should be bright everywhere and saturated nowhere; change the exposure if it is not.",
    "dark": "Cover the lens, and leave the exposure as it is.",
}
"""What the user does first."""

PARTS = 4
"""Parts of the sensor along rows and columns, of which so many must be lit to a share of the brightest."""
LIT = 0.75
DIM = 0.1
SATURATED = 1e-3
BRIGHT = 0.15
DARK = 0.05


@dataclass(frozen=True)
class Stills:
    """What was written: kind, files, and how bright the frames are (share of the range above black)."""

    kind: str
    files: tuple[Path, ...]
    level: float

    def words(self) -> str:
        """Return it in a line."""
        return (
            f"{len(self.files)} {self.kind} frames in {self.files[0].parent}, at {100 * self.level:.0f} % of the range"
        )


def still_files(folder: Path, kind: str) -> tuple[Path, ...]:
    """Return the files that `iter_stills` writes."""
    return tuple(folder / kind / f"{kind}_{k}.tif" for k in range(COUNT))


def recipe_of(folder: Path) -> CorrectionRecipe:
    """Return the corrections that a session calls for: by the white image beside it, with its dark frames."""
    white, dark = (folder / kind if still_files(folder, kind)[0].is_file() else "" for kind in ("white", "dark"))
    # a recording has darks of its own; those of the whole sensor are there for the white image
    return CorrectionRecipe(white=white, dark=dark) if white else CorrectionRecipe()


def iter_stills(station: Station, plan: ScanPlan, exposure_s: float, folder: Path, kind: str) -> Work[Stills]:
    """Take frames of the whole sensor, check them, and write them as 16-bit TIFF; the light is on again afterwards.

    Raises
    ------
    InputError
        If white frames are dim, saturated or not lit everywhere, or dark frames are not dark.
    StorageError
        Before any is taken, if they cannot be written there.
    """
    files = still_files(folder, kind)
    for path in files:
        check_writable(path)
    clock, frames = Clock(f"{kind} frames", COUNT), []
    light = station.rig.light if kind == "dark" else None
    take = _taker(station, plan, exposure_s, kind)
    try:
        if light is not None:
            light.switch(False)
        for k in range(COUNT):
            yield clock.at(k)
            frames.append(take(k))
    finally:
        if light is not None:
            light.switch(True)
    level = _checked(np.mean(frames, axis=0, dtype=np.float64), plan, kind)
    import tifffile  # slow to load

    for path, frame in zip(files, frames, strict=True):
        with replace_whole(path) as part:
            tifffile.imwrite(part, frame)
    yield clock.at(COUNT)
    return Stills(kind, files, level)


def _taker(station: Station, plan: ScanPlan, exposure_s: float, kind: str) -> Callable[[int], NDArray[Any]]:
    """Return what takes frame ``k``; the simulator's source is a point, so its white scene is simulated as a whole."""
    if station.name == "sim" and kind == "white":
        from lfcal.simulate import SimulatedCamera

        scene = SimulatedCamera(plan, ())
        return lambda k: np.rint(scene.white_frame(k)).astype(np.uint16)

    def take(_: int) -> NDArray[Any]:
        look = station.look(exposure_s, plan)
        if look.frame is None or look.state.trouble:
            raise InputError.expected("frame", "one", look.state.trouble or "none", "check the camera")
        return np.array(look.frame.data)

    return take


def _checked(mean: NDArray[np.float64], plan: ScanPlan, kind: str) -> float:
    """Return how bright the frames are; raise `InputError` where they are not what they should be."""
    sensor = plan.camera.sensor
    shares = (mean - sensor.black_level) / (sensor.max_value - sensor.black_level)
    level = float(np.percentile(shares, 99))
    if kind == "dark":
        if level > DARK:
            raise InputError.expected(
                "dark frames", f"at most {100 * DARK:.0f} % of the range", f"{100 * level:.0f} %", "cover the lens"
            )
        return level
    if level < BRIGHT:
        raise InputError.expected(
            "white frames", f"at least {100 * BRIGHT:.0f} % of the range", f"{100 * level:.0f} %", "expose longer"
        )
    if float((mean >= sensor.max_value).mean()) > SATURATED:
        raise InputError.expected("white frames", "no saturated pixels", "many of them", "expose shorter")
    rows, columns = (np.array_split(np.arange(n), PARTS) for n in mean.shape)
    parts = [float(np.percentile(shares[np.ix_(r, c)], 95)) for r in rows for c in columns]
    lit = float(np.mean([part > DIM * level for part in parts]))
    if lit < LIT:
        raise InputError.expected(
            "white frames",
            f"light on {100 * LIT:.0f} % of the sensor",
            f"on {100 * lit:.0f} %",
            "put an even light or a diffuser before the lens",
        )
    return level
