"""The comparison of modulators as a command. No Qt."""

from __future__ import annotations

from gui.models.project import ProjectState
from gui.models.step import CAMERA_FILE, Step, options_of
from gui.pages.multiplex.model import TYPED, MultiplexSettings
from lfcal.errors import InputError

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> Step:
    """Return how the modulator is compared with its reference."""
    chosen = MultiplexSettings.of(project)
    if chosen.family == "both":
        raise InputError.expected("modulator", "filters or a mask", "a mask over filters", "the command knows either")
    if chosen.family == "written":
        own, other = chosen.written, chosen.reference_written
        made, over = f"modulator_of({own!r})", f"modulator_of({other!r})"
    elif chosen.family == "cfa":
        own, other = chosen.pattern if chosen.cfa == TYPED else chosen.cfa, chosen.reference_cfa
        made, over = f"cfa({own!r})", f"cfa({other!r})"
    else:
        own, other = f"{chosen.mask}:{chosen.size}", f"{chosen.reference_mask}:{chosen.size}"
        made, over = f"mask({chosen.mask!r}, {chosen.size})", f"mask({chosen.reference_mask!r}, {chosen.size})"
    pairs = (("--reference", other), ("--camera", CAMERA_FILE), ("--gain", repr(chosen.gain)))
    python = f"""
from lfcal.camera import Camera
from lfcal.multiplex import camera_chi2, cfa, mask, modulator_of, snr_gain

camera = Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))
print(snr_gain({made}, {over}, camera_chi2(camera.sensor, gain={chosen.gain!r})))
"""
    files = ((CAMERA_FILE, project.camera.to_json()),)
    return Step(("multiplex", "compare", *dict.fromkeys((other, own)), *options_of(pairs)), python, files)
