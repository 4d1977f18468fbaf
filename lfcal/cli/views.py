"""``lfcal views``: sub-aperture views and focal stacks of a light-field frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, check_choice, check_number
from lfcal.camera import Camera
from lfcal.cli._colour_planes import CHANNELS, ColourReading
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import ForceOption, JsonOption, OriginOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.cli._views_frame import GivenLattice, ViewedFrame, viewed_frame
from lfcal.records import read_as, read_depths, read_virtual_depths
from lfcal.tasks import check_outputs, load_camera

if TYPE_CHECKING:
    from lfcal.lattice import FrameLattice, RenderedPlanes, Views


TYPES = ("none", "together", "each")
SLOPES = {"none": "-6:6:2", "together": "2:6:0.5", "each": "2:6:0.5"}
"""Planes of the focal stack by default: lens types see those beyond the lenslets' own plane."""


@dataclass(frozen=True)
class _Wish:
    """What is wanted: axes, field, lens types and the camera that has them, planes, samples."""

    axes: str
    full: bool
    types: str
    slopes: tuple[float, ...]
    samples: int
    workers: int | None
    camera: Camera | None

    @property
    def labels(self) -> list[str]:
        """What the names of files have for each lattice that views are cut on."""
        return [f"_type{k}" for k in range(3)] if self.types == "each" else [""]

    @property
    def names(self) -> list[str]:
        """The files to write."""
        from lfcal.lattice import TOTAL, stack_names, view_names

        names = [name for label in self.labels for name in (*view_names(label), *stack_names(label, self.slopes))]
        return names + (list(TOTAL) if self.types == "together" else [])


def command(
    context: typer.Context,
    frame: Path = typer.Argument(..., help="Light-field frame: TIFF, PNG, NPY or camera RAW."),
    *,
    white: Path | None = typer.Option(None, help="White image of the same camera: lattice and weights."),
    lattice: Path | None = typer.Option(None, help="lattice.json of `lfcal white`: measured once, not again."),
    camera: str = typer.Option("", help="Camera (preset, JSON, Raytrix XML): lattice without --white; depths; types."),
    dark: Path | None = typer.Option(None, help="Dark frame, or a folder of them to average; subtracted from both."),
    origin: OriginOption = "",
    kind: str = typer.Option("", help="square or hexagonal lattice of --white; by default detected, or the camera's."),
    pitch: float = typer.Option(0.0, help="Nominal pitch (px) of --white, right within 10 %; by default detected."),
    axes: str = typer.Option("frame", help="Rows run along the frame's or the lattice's."),
    full: bool = typer.Option(
        False, "--full", help="The whole field, NaN where nothing is seen; else the largest box."
    ),
    types: str = typer.Option("none", help="Lens types: none, together (the sharpest count most), or each alone."),
    channel: str = typer.Option("", help="Of colour frames: R, G, B or each; all of a mosaic by default."),
    cfa: str = typer.Option("", help="Colour filters of a mosaic by rows, e.g. GRBG; by default what the file says."),
    slopes: str = typer.Option("", help="Planes of the focal stack as slopes (about virtual depths)."),
    depths: str = typer.Option("", help="The same as depths in µm or mm; needs --camera."),
    samples: int = typer.Option(4, help="Samples per lenslet of the focal stack."),
    out: Path | None = typer.Option(None, "-o", "--out", help="Folder for stacks and pictures."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Cut sub-aperture views and a focal stack out of a light-field frame.

    Example: `lfcal views frame.tif --white white.tif --dark dark.tif -o out`
    """
    from lfcal.frames import parse_origin
    from lfcal.lattice import check_slopes

    for what, value, choices in (
        ("axes", axes, ("frame", "lattice")),
        ("types", types, TYPES),
        ("channel", channel, CHANNELS),
    ):
        check_choice(what, value, choices)
    if white is None or lattice is not None:
        refuse(context, "a --white whose lattice is measured", "none", "kind", "pitch")
    if depths:
        refuse(context, "planes given once", "--depths", "slopes")
    described = load_camera(camera) if camera else None
    if types != "none" and lattice is not None and white is None:
        raise InputError("--types: needs --white in addition to --lattice; or give the camera.json of lfcal white")
    if types != "none" and (described is None or len(described.lattice.types) != 3):
        raise InputError.expected("lens types", "a --camera with three", camera or "none", "leave --types out")
    check_number("samples per lenslet", samples, at_least=1, at_most=32, integer=True)
    planes = _slopes(slopes or SLOPES[types], depths, described)
    wish = _Wish(axes, full, types, planes, samples, workers, described)
    if types != "none":
        check_slopes(wish.slopes)
    written = [] if out is None else [out / name for name in wish.names]
    check_outputs(written, frame, white, lattice, dark, camera, force=force)
    reading = ColourReading(channel, cfa, dark, parse_origin(origin))
    scene = viewed_frame(frame, GivenLattice(white, lattice, kind, pitch), described, reading)
    views = {label: _views(scene, part, wish) for label, part in _lattices(scene, wish).items()}
    if out is not None:
        _save(scene, views, wish, out)
    if json:
        print_json({**scene.to_dict(views), "written": written})
        return
    print_table(["light field", frame.name], scene.rows(views))
    for path in written:
        typer.echo(f"written: {path}")


def _slopes(text: str, depths: str, camera: Camera | None) -> tuple[float, ...]:
    from lfcal.lattice import sensor_slope

    if not depths:
        return read_as("--slopes", read_virtual_depths, text)
    if camera is None:
        raise InputError("depths: need --camera to know where they are focused; give it, or --slopes instead")
    return tuple(sensor_slope(camera, z) for z in read_as("--depths", read_depths, depths))


def _lattices(scene: ViewedFrame, wish: _Wish) -> dict[str, FrameLattice]:
    """Return the lattices that views are cut on: all lenslets, or those of each type."""
    from lfcal.lattice import type_lattice

    if wish.types != "each" or scene.type_of is None:
        return {"": scene.lattice}
    # each type has its own lattice; its samples stay those of all
    return {label: type_lattice(scene.lattice, scene.type_of, k) for k, label in enumerate(wish.labels)}


def _views(scene: ViewedFrame, lattice: FrameLattice, wish: _Wish) -> list[Views]:
    """Return the views of each colour."""
    from lfcal.lattice import TypeLattice, extract_views

    return [
        extract_views(
            plane,
            lattice,
            white=None if scene.white is None else scene.white[name],
            radius_px=scene.radius_px,
            axes=wish.axes,
            full=wish.full,
            missing=lattice.among(scene.missing) if isinstance(lattice, TypeLattice) else scene.missing,
            raster=None if lattice is scene.lattice else scene.lattice,
            workers=wish.workers,
        )
        for name, plane in scene.planes.items()
    ]


def _save(scene: ViewedFrame, views: dict[str, list[Views]], wish: _Wish, out: Path) -> None:
    """Write views, focal stacks and, of lens types together, what is in focus all over the field."""
    import numpy as np

    from lfcal.lattice import refocus, save_focal_stack, save_total_focus, save_views, sharpness_shares, total_focus

    for k, (label, colours) in enumerate(views.items()):
        save_views(out, label, colours, wish.samples)
        if wish.types == "none":
            stack = [refocus(one, wish.slopes, samples=wish.samples) for one in colours]
        else:
            assert wish.camera is not None  # lens types are a camera's
            single, together = np.eye(3)[k], wish.types == "together"
            shares = [sharpness_shares(wish.camera, slope) if together else single for slope in wish.slopes]
            planes = _rendered(scene, shares, wish)
            stack = [one.images for one in planes]
            if together:
                save_total_focus(out, [total_focus(one) for one in planes])
        save_focal_stack(out, label, stack, wish.slopes)


def _rendered(scene: ViewedFrame, shares: list[Any], wish: _Wish) -> list[RenderedPlanes]:
    """Return the focal stack of each colour, with the ``shares`` of lens types in its planes."""
    from lfcal.lattice import render

    return [
        render(
            plane,
            scene.lattice,
            wish.slopes,
            type_of=scene.type_of,
            shares=shares,
            white=None if scene.white is None else scene.white[name],
            radius_px=scene.radius_px,
            samples=wish.samples,
            workers=wish.workers,
        )
        for name, plane in scene.planes.items()
    ]
