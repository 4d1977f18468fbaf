"""``lfcal views``: sub-aperture views and focal stacks of a light-field frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, check_choice, check_number
from lfcal.camera import Camera
from lfcal.cli._colour_planes import CHANNELS, ColourReading, read_planes
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import ForceOption, JsonOption, OriginOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.cli._views_files import save_picture, save_stack, stack_names, view_names
from lfcal.cli._views_input import Given, ViewedFrame, cutting_of
from lfcal.cli._views_report import as_json, rows
from lfcal.records import read_as, read_depths, read_virtual_depths
from lfcal.tasks import check_outputs, load_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.lattice import FrameLattice, Views

__all__ = ["register"]

TYPES = ("none", "together", "each")
SLOPES = {"none": "-6:6:2", "together": "2:6:0.5", "each": "2:6:0.5"}
"""Planes of the focal stack where nobody names them: lens types see those beyond the lenslets' own plane."""

TOTAL = ["all_in_focus.tif", "all_in_focus.png", "slopes.tif"]


@dataclass(frozen=True)
class _Wish:
    """What is asked for: axes, field, lens types, planes, samples."""

    axes: str
    full: bool
    types: str
    slopes: tuple[float, ...]
    samples: int
    workers: int | None


def register(app: typer.Typer) -> None:
    """Add ``views`` to the app."""
    app.command("views")(command)


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
    for what, value, choices in (("axes", axes, ("frame", "lattice")), ("types", types, TYPES)):
        check_choice(what, value, choices)
    check_choice("channel", channel, CHANNELS)
    from lfcal.frames import parse_origin

    if white is None or lattice is not None:
        refuse(context, "a --white whose lattice is measured", "none", "kind", "pitch")
    if depths:
        refuse(context, "planes given once", "--depths", "slopes")
    described = load_camera(camera) if camera else None
    if types != "none" and lattice is not None and white is None:
        raise InputError("--types: needs --white beside --lattice; or give the camera.json that lfcal white wrote")
    if types != "none" and (described is None or len(described.lattice.types) != 3):
        raise InputError.expected("lens types", "a --camera with three", camera or "none", "leave --types out")
    check_number("samples per lenslet", samples, at_least=1, at_most=32, integer=True)
    wish = _Wish(axes, full, types, _slopes(slopes or SLOPES[types], depths, described), samples, workers)
    if types != "none":
        from lfcal.lattice import check_slopes

        check_slopes(wish.slopes)
    if out is not None:
        check_outputs([out / name for name in _names(wish)], frame, white, lattice, dark, camera, force=force)
    reading = ColourReading(channel, cfa, dark, parse_origin(origin))
    planes = read_planes(frame, reading)
    scene = ViewedFrame(planes, cutting_of(planes, Given(white, lattice, kind, pitch), described, reading), described)
    views = {label: _views(scene, part, wish) for label, part in _lattices(scene, wish).items()}
    written = [] if out is None else _save(scene, views, wish, out)
    if json:
        print_json(as_json(scene, views, written))
        return
    print_table(["light field", frame.name], rows(scene, views))
    for path in written:
        typer.echo(f"written: {path}")


def _slopes(text: str, depths: str, camera: Camera | None) -> tuple[float, ...]:
    from lfcal.lattice import sensor_slope

    if depths and camera is None:
        raise InputError("depths: need --camera to know where they are focused; give it, or --slopes instead")
    if depths and camera is not None:
        return tuple(sensor_slope(camera, z) for z in read_as("--depths", read_depths, depths))
    return read_as("--slopes", read_virtual_depths, text)


def _labels(wish: _Wish) -> list[str]:
    return [f"_type{k}" for k in range(3)] if wish.types == "each" else [""]


def _names(wish: _Wish) -> list[str]:
    """Return the files that will be written."""
    names = [name for label in _labels(wish) for name in (*view_names(label), *stack_names(label, wish.slopes))]
    return names + (TOTAL if wish.types == "together" else [])


def _lattices(scene: ViewedFrame, wish: _Wish) -> dict[str, FrameLattice]:
    """Return the lattices that views are cut on: all lenslets, or those of each type."""
    from lfcal.lattice import type_lattice

    cutting = scene.cutting
    if wish.types != "each" or cutting.type_of is None:
        return {"": cutting.lattice}
    # a lattice of its own for each type; its samples stay those of all
    return {label: type_lattice(cutting.lattice, cutting.type_of, k) for k, label in enumerate(_labels(wish))}


def _views(scene: ViewedFrame, lattice: FrameLattice, wish: _Wish) -> list[Views]:
    """Return the views of each colour."""
    from lfcal.lattice import TypeLattice, extract_views

    cutting, whole = scene.cutting, lattice is scene.cutting.lattice
    return [
        extract_views(
            plane,
            lattice,
            white=None if cutting.white is None else cutting.white[name],
            radius_px=cutting.radius_px,
            axes=wish.axes,
            full=wish.full,
            missing=lattice.among(cutting.missing) if isinstance(lattice, TypeLattice) else cutting.missing,
            raster=None if whole else cutting.lattice,
            workers=wish.workers,
        )
        for name, plane in scene.planes.items()
    ]


def _save(scene: ViewedFrame, views: dict[str, list[Views]], wish: _Wish, out: Path) -> list[Path]:
    """Write views and focal stacks; return the files in the order of `_names`."""
    stacks, more = _stacks(scene, views, wish)
    for label, colours in views.items():
        _save_views(out, label, colours, wish.samples)
        _save_focal_stack(out, label, stacks[label], wish.slopes)
    for name, image in more.items():
        save_stack(out / f"{name}.tif", image, "CYX" if image.ndim == 3 else "YX")
    if more:
        save_picture(out / TOTAL[1], more["all_in_focus"])
    return [out / name for name in _names(wish)]


def _stacks(
    scene: ViewedFrame, views: dict[str, list[Views]], wish: _Wish
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Return the focal stacks ``(n, rows, columns)``, or with colours second, and what else is to be written."""
    import numpy as np

    from lfcal.lattice import refocus, render, sharpness_shares, total_focus

    if wish.types == "none":
        stack = [refocus(one, wish.slopes, samples=wish.samples) for one in views[""]]
        return {"": _joined(stack, 1)}, {}
    cutting, camera = scene.cutting, scene.camera
    assert camera is not None

    def planes(shares: list[Any]) -> list[Any]:
        return [
            render(
                plane,
                cutting.lattice,
                wish.slopes,
                type_of=cutting.type_of,
                shares=shares,
                white=None if cutting.white is None else cutting.white[name],
                radius_px=cutting.radius_px,
                samples=wish.samples,
                workers=wish.workers,
            )
            for name, plane in scene.planes.items()
        ]

    if wish.types == "each":
        single = {label: planes([np.eye(3)[k]] * len(wish.slopes)) for k, label in enumerate(_labels(wish))}
        return {label: _joined([one.images for one in found], 1) for label, found in single.items()}, {}
    found = planes([sharpness_shares(camera, slope) for slope in wish.slopes])
    focused = [total_focus(one) for one in found]
    more = {"all_in_focus": _joined([image for image, _ in focused], 0), "slopes": _joined([s for _, s in focused], 0)}
    return {"": _joined([one.images for one in found], 1)}, more


def _joined(colours: list[NDArray[Any]], axis: int) -> NDArray[Any]:
    import numpy as np

    return colours[0] if len(colours) == 1 else np.stack(colours, axis=axis)


def _save_views(out: Path, label: str, colours: list[Views], times: int) -> None:
    """Write all views as a stack ``(v, u, y, x)`` (ImageJ: t and z), side by side, and the middle one."""
    import numpy as np

    names = view_names(label)
    images = _joined([np.where(one.mask, one.images, np.float32(np.nan)) for one in colours], 2)
    save_stack(out / names[0], images, "TZCYX" if len(colours) > 1 else "TZYX")
    pictures: tuple[tuple[str, Callable[[Views], Any], int], ...] = (
        (names[1], lambda one: one.mosaic(2), 1),
        (names[2], lambda one: one.central, times),
    )
    for name, of, larger in pictures:
        shown = _joined([of(one) for one in colours], 0)
        save_picture(out / name, shown if shown.ndim == 2 or len(shown) == 3 else shown[0], larger)


def _save_focal_stack(out: Path, label: str, stack: NDArray[Any], slopes: tuple[float, ...]) -> None:
    names = stack_names(label, slopes)
    save_stack(out / names[0], stack, "ZCYX" if stack.ndim == 4 else "ZYX", [f"slope {w:+.3f}" for w in slopes])
    for name, image in zip(names[1:], stack, strict=True):
        save_picture(out / name, image)
