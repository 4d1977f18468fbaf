"""The comparison of modulators, or the reconstruction of an opened frame, as a command. No Qt."""

from __future__ import annotations

from pathlib import Path

from lfcal.base import InputError
from lfcal_gui.models import CAMERA_FILE, CommandStep, ProjectState, options_of
from lfcal_gui.pages.multiplex.model import TYPED, MultiplexSettings
from lfcal_gui.pages.multiplex.model_scene import is_frame, measured_in


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that compares the modulator with its reference, or that demultiplexes the opened frame."""
    chosen = MultiplexSettings.of(project)
    if chosen.scene == "image" and chosen.image:
        if chosen.route == "lattice":
            return _views(project, chosen, out or "views.tif")
        if chosen.route == "general" or chosen.dead or chosen.weighted or is_frame(chosen.image):
            return _recovered(project, chosen, out or "samples.tif")
    if chosen.family == "both":
        raise InputError.expected(
            "modulator", "filters or a mask", "a mask combined with filters", "choose one of the two families"
        )
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
    return CommandStep(("multiplex", "compare", *dict.fromkeys((other, own)), *options_of(pairs)), python, files)


def _views(project: ProjectState, chosen: MultiplexSettings, out: str) -> CommandStep:
    white = measured_in(project)
    weighed = chosen.weighted or bool(chosen.dead)
    pairs = (
        ("--white", white),
        ("--camera", "" if white else CAMERA_FILE),
        ("--modulator", chosen.named()),
        ("--route", "both"),
        ("--filter", "linear" if weighed else chosen.filter),
        ("--sensor", CAMERA_FILE if chosen.weighted else ""),
        ("--gain", chosen.gain if chosen.weighted else None),
        ("--mask", chosen.dead),
        ("--out", out),
    )
    lattice = f"fit_lattice(read_average({white!r}))" if white else "lattice_of(camera)"
    how = "weights=weights" if weighed else f"filter={chosen.filter!r}"
    python = f"""
import numpy as np

from lfcal.camera import Camera
from lfcal.frames import open_image, read_image
from lfcal.frames.corrections.recipe import read_average
from lfcal.lattice import fit_lattice, lattice_of
from lfcal.multiplex import demultiplex_lattice, modulator_of, pixel_weights, without_black_level
from lfcal.base.files import write_tiff

camera = Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))
{_reading(chosen)}
modulator, lattice = modulator_of({chosen.named()!r}), {lattice}
views = demultiplex_lattice(light, lattice, modulator, {how})
write_tiff(Path({out!r}), views.astype("f4"), metadata=None)
fourier = demultiplex_lattice(np.nan_to_num(light), lattice, modulator, route="fourier")
write_tiff(Path({_fourier(out)!r}), fourier.astype("f4"), metadata=None)
"""
    files = ((CAMERA_FILE, project.camera.to_json()),)
    return CommandStep(("multiplex", "views", chosen.image, *options_of(pairs)), python, files)


def _fourier(out: str) -> str:
    path = Path(out)
    return str(path.with_name(f"{path.stem}_fourier{path.suffix}"))


def _recovered(project: ProjectState, chosen: MultiplexSettings, out: str) -> CommandStep:
    general, weighed = chosen.route == "general", chosen.weighted or bool(chosen.dead)
    own = chosen.transmissions if general else ""
    # the command solves by iterations where transmissions or a spacing are given
    node = chosen.spacing or (None if own else chosen.modulator().count ** 0.5)
    pairs = (
        ("--transmissions" if own else "--modulator", own or chosen.named()),
        ("--spacing", node if general else None),
        ("--smoothness", chosen.smoothness if general else None),
        ("--route", "" if general else "both"),
        ("--filter", "" if general or weighed else chosen.filter),
        ("--mask", chosen.dead),
        ("--camera", CAMERA_FILE if chosen.weighted else None),
        ("--gain", chosen.gain if chosen.weighted else None),
        ("--out", out),
    )
    camera = (
        f"""
camera = Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))"""
        if chosen.weighted
        else ""
    )
    python = f"""
import numpy as np

from lfcal.camera import Camera
from lfcal.frames import open_image, read_image
from lfcal.multiplex import demultiplex, demultiplex_generally, demultiplex_weighted, modulator_of
from lfcal.multiplex import pixel_weights, without_black_level
from lfcal.base.npy import map_npy
from lfcal.base.files import write_tiff
{camera}
{_reading(chosen)}
shares = {f"map_npy({own!r})" if own else f"modulator_of({chosen.named()!r})"}
{_solving(chosen, out)}
"""
    files = ((CAMERA_FILE, project.camera.to_json()),) if chosen.weighted else ()
    return CommandStep(("multiplex", "recover", chosen.image, *options_of(pairs)), python, files)


def _reading(chosen: MultiplexSettings) -> str:
    """Return code that reads the frame, its weights and its light."""
    level = "camera.sensor.black_level" if chosen.weighted else "0.0"
    dead = f"read_image({chosen.dead!r}) != 0" if chosen.dead else "np.zeros(frame.shape, bool)"
    weights = "np.where(dead, 0.0, 1.0)"
    if chosen.weighted:
        weights = f"pixel_weights(frame, camera.sensor, dead=dead, gain={chosen.gain!r}, black_level=level)"
    return f"""image = open_image({chosen.image!r})  # all of it; the page uses only the middle of a large one
frame, level = image.read(0).astype(float), image.metadata.get("black_level", {level})
image.close()
dead = {dead}
weights, light = {weights}, without_black_level(frame, level)"""


def _solving(chosen: MultiplexSettings, out: str) -> str:
    """Return code that computes the samples and saves them."""
    weighed = chosen.weighted or bool(chosen.dead)
    solve = "demultiplex_weighted(light, shares, weights).samples"
    if chosen.route == "general":
        count = "len(shares)" if chosen.transmissions else "shares.count"
        spacing = repr(chosen.spacing) if chosen.spacing else f"{count} ** 0.5"
        options = f"weights=weights, smoothness={chosen.smoothness!r}"
        solve = f"demultiplex_generally(light, shares, {spacing}, {options}).samples"
    elif not weighed:
        solve = f"demultiplex(light, shares, filter={chosen.filter!r})"
    lines = f"""found = {solve}
write_tiff(Path({out!r}), found.astype("f4"), metadata=None)"""
    if chosen.route == "general":
        return lines
    return f"""{lines}
fourier = demultiplex(np.nan_to_num(light), shares, route="fourier")
write_tiff(Path({_fourier(out)!r}), fourier.astype("f4"), metadata=None)"""
