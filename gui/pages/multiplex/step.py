"""The comparison of modulators, or the reconstruction of an opened frame, as a command. No Qt."""

from __future__ import annotations

from gui.models.project import ProjectState
from gui.models.step import CAMERA_FILE, Step, options_of
from gui.pages.multiplex.model import TYPED, MultiplexSettings
from lfcal.errors import InputError

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> Step:
    """Return how the modulator is compared with its reference, or how an opened frame is recovered.

    It is recovered where a route, a map of dead pixels, or weights are chosen for it.
    """
    chosen = MultiplexSettings.of(project)
    if chosen.scene == "image" and chosen.image:
        if chosen.route == "lattice":
            return _views(project, chosen, out or "views.tif")
        if chosen.route == "general" or chosen.dead or chosen.weighted:
            return _recovered(project, chosen, out or "samples.tif")
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


def _views(project: ProjectState, chosen: MultiplexSettings, out: str) -> Step:
    pairs = (("--camera", CAMERA_FILE), ("--modulator", chosen.named()), ("--filter", chosen.filter), ("--out", out))
    python = f"""
from lfcal.camera import Camera
from lfcal.frames import read_image
from lfcal.lattice import lattice_of
from lfcal.multiplex import demultiplex_lattice, modulator_of
from lfcal.tiff_file import write_tiff

camera = Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))
frame, modulator = read_image({chosen.image!r}), modulator_of({chosen.named()!r})
views = demultiplex_lattice(frame.astype("f4"), lattice_of(camera), modulator, filter={chosen.filter!r})
write_tiff(Path({out!r}), views.astype("f4"), metadata=None)
"""
    files = ((CAMERA_FILE, project.camera.to_json()),)
    return Step(("multiplex", "views", chosen.image, *options_of(pairs)), python, files)


def _recovered(project: ProjectState, chosen: MultiplexSettings, out: str) -> Step:
    general = chosen.route == "general"
    own = chosen.transmissions if general else ""
    spacing = repr(chosen.spacing) if chosen.spacing else "len(shares) ** 0.5" if own else "shares.count ** 0.5"
    # the command solves by iterations where transmissions or a spacing are given
    node = chosen.spacing or (None if own else chosen.modulator().count ** 0.5)
    pairs = (
        ("--transmissions" if own else "--modulator", own or chosen.named()),
        ("--spacing", node if general else None),
        ("--smoothness", chosen.smoothness if general else None),
        ("--dead", chosen.dead),
        ("--camera", CAMERA_FILE if chosen.weighted else None),
        ("--gain", chosen.gain if chosen.weighted else None),
        ("--out", out),
    )
    solve = (
        f"demultiplex_generally(light, shares, {spacing}, weights=weights, smoothness={chosen.smoothness!r})"
        if general
        else "demultiplex_weighted(light, shares, weights)"
    )
    python = f"""
import numpy as np

from lfcal.camera import Camera
from lfcal.frames import read_image
from lfcal.multiplex import demultiplex_generally, demultiplex_weighted, modulator_of, pixel_weights
from lfcal.npy import map_npy
from lfcal.tiff_file import write_tiff

frame = read_image({chosen.image!r}).astype(float)
dead = {f"read_image({chosen.dead!r}) != 0" if chosen.dead else "np.zeros(frame.shape, bool)"}
shares = {f"map_npy({own!r})" if own else f"modulator_of({chosen.named()!r})"}
{_weighting(chosen)}
found = {solve}
write_tiff(Path({out!r}), found.samples.astype("f4"), metadata=None)
"""
    files = ((CAMERA_FILE, project.camera.to_json()),) if chosen.weighted else ()
    return Step(("multiplex", "recover", chosen.image, *options_of(pairs)), python, files)


def _weighting(chosen: MultiplexSettings) -> str:
    if not chosen.weighted:
        return "weights, light = np.where(dead, 0.0, 1.0), frame"
    return f"""camera = Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))
weights = pixel_weights(frame, camera.sensor, dead=dead, gain={chosen.gain!r})
light = frame - camera.sensor.black_level"""
