"""``lfcal views``: make sub-aperture views and focal stacks from a light-field frame."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, check_choice, check_number, format_pixels
from lfcal.camera import Camera
from lfcal.cli._console import print_result, print_written
from lfcal.cli._options import ForceOption, JsonOption, MaskOption, OriginOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import CHANNELS, ColourReading, Planes, mean_plane, read_planes
from lfcal.records import read_as, read_depths, read_virtual_depths
from lfcal.tasks import check_outputs, load_camera

if TYPE_CHECKING:
    from lfcal.lattice import FrameLattice, TypeOf, Views


@dataclass(frozen=True)
class GivenLattice:
    """Options for the lattice: a white image, a lattice file, and the kind and nominal pitch (px) for a fit.

    The lattice is fitted to the white image only if there is no file. A kind that is empty is that of the camera or is
    detected; a pitch of 0 is detected.
    """

    white: Path | None
    file: Path | None
    kind: str
    pitch_px: float


@dataclass(frozen=True)
class ViewedFrame:
    """A frame by colour, with all that is needed to extract views from it.

    ``planes`` contains the samples of each colour. ``source`` describes the origin of ``lattice``. ``type_of`` returns
    the types of the lenslets (q, r) (None: a single type), and ``missing`` contains the indices (q, r) of dark
    lenslets. ``white`` is the white image by colour. If it is None, all pixels within ``radius_px`` (px) of a
    micro-image centre have equal weight.
    """

    planes: Planes
    lattice: FrameLattice
    source: str
    type_of: TypeOf | None
    missing: Sequence[tuple[int, int]] = ()
    white: Planes | None = None
    radius_px: float | None = None

    def rows(self, found: dict[str, list[Views]]) -> list[list[str]]:
        """Return the rows of the table of views; ``found`` lists the views of each colour, by lens type."""
        views, lattice = next(iter(found.values()))[0], self.lattice
        count, masked = len(views.offsets), int((~views.mask).sum())
        turned = f"turned by {math.degrees(lattice.rotation_rad):+.3f}°"
        table = [
            ["lattice", f"{lattice.kind}, {lattice.pitch_px:.3f} px, {turned}, {self.source}"],
            ["views", f"{count} x {count}, spaced by one pixel of the micro-images"],
            *([f"samples of a view{k.replace('_type', ', type ')}", of[0].grid.described()] for k, of in found.items()),
            ["sample spacing", f"{views.step_px[0]:.3f} px down, {views.step_px[1]:.3f} px right"],
            ["rows run along", "the frame" if views.rotation_rad == 0 else f"the lattice ({turned})"],
        ]
        if masked:
            table.append(["seen by no lenslet", f"{masked} of {views.mask.size} samples (NaN in views.tif)"])
        return table if "" in self.planes else [*table, ["colours", ", ".join(self.planes)]]

    def read(self) -> Iterator[tuple[Any, dict[str, Any]]]:
        """Yield the samples of each colour, with the white image and the radius (px) that determine the weights."""
        for name, plane in self.planes.items():
            yield plane, {"white": None if self.white is None else self.white[name], "radius_px": self.radius_px}

    def to_dict(self, found: dict[str, list[Views]]) -> dict[str, Any]:
        """Return facts about the views and the lattice as plain values for JSON; ``found`` is as in `rows`."""
        views = next(iter(found.values()))[0]
        names = ("kind", "pitch_px", "row_pitch_px", "rotation_rad")
        return {
            "lattice": {name: getattr(self.lattice, name) for name in names} | {"source": self.source},
            "views": len(views.offsets),
            "fields": {label.lstrip("_") or "all": _field(of[0]) for label, of in found.items()},
            **{name: getattr(views, name) for name in ("step_px", "rotation_rad", "radius_px")},
            "colours": [name for name in self.planes if name],
        }


def _field(views: Views) -> dict[str, Any]:
    """Return the positions of the samples of a set of views, and the part of the field they cover."""
    grid, masked = views.grid, int((~views.mask).sum())
    own = {"shape": views.shape, "whole": grid.field_shape, "kept": grid.kept}
    return own | {"masked": masked, "corner_px": grid.corner_px}


def viewed_frame(path: Path, given: GivenLattice, camera: Camera | None, reading: ColourReading) -> ViewedFrame:
    """Return the frame in ``path`` with the lattice for its views: from a white image, a file, or the camera.

    Without a white image, all pixels within a radius of each micro-image centre have equal weight. The radius is half
    of the pitch, of the row pitch, or (given ``camera``) of the lenslets' clear diameter, whichever is smallest.
    Without a white image, a file and a camera, `InputError` is raised.
    """
    from lfcal.lattice import cropped, lattice_of, load_lattice

    planes = read_planes(path, reading)
    if given.white is not None:
        return _by_white(planes, given.white, given, camera, reading)
    shape = next(iter(planes.values())).shape
    missing: Sequence[tuple[int, int]] = ()
    type_of, clear = None, math.inf
    if camera is not None:
        clear = camera.lattice.clear_diameter_um / camera.sensor.pixel_um
    if given.file is not None:
        fit = load_lattice(given.file)
        lattice, missing = cropped(fit, shape, reading.origin), fit.dead_lenslets
        source = f"of {given.file.name}; no white image: aperture"
    elif camera is not None:
        lattice = lattice_of(camera, shape, reading.origin)
        type_of = camera.lattice.type_of if len(camera.lattice.types) == 3 else None
        source = f"of camera {camera.name}; no white image: clear aperture"
    else:
        raise InputError("lattice: expected --white, --lattice or --camera, got none; add one of these options")
    radius = min(clear, lattice.pitch_px, lattice.row_pitch_px) / 2
    return ViewedFrame(planes, lattice, f"{source} of {2 * radius:.2f} px", type_of, missing, radius_px=radius)


def _by_white(
    planes: Planes, white: Path, given: GivenLattice, camera: Camera | None, reading: ColourReading
) -> ViewedFrame:
    """Return the frame with lattice and weights from a white image; the lattice is fitted if no file contains it."""
    from lfcal.lattice import classify_lens_types, cropped, expected_blur, fit_lattice, load_lattice

    # the white image shows the whole sensor
    light = read_planes(white, replace(reading, origin=None))
    if light.keys() != planes.keys():
        wanted, got = (", ".join(one) or "none (grey)" for one in (planes, light))
        raise InputError.expected(str(white), f"colours {wanted}", got, "use one camera for both")
    bright, source = mean_plane(light), f"of {white.name}"
    if given.file is not None:
        fit, source = load_lattice(given.file), f"of {given.file.name}, light of {white.name}"
        if fit.shape != bright.shape:
            raise InputError.expected(
                str(white),
                f"{format_pixels(fit.shape)}, as the lattice has",
                format_pixels(bright.shape),
                "use the white image of this lattice",
            )
    else:
        kind = given.kind or (camera.lattice.kind if camera else None)
        fit = fit_lattice(bright, kind=kind, pitch_px=given.pitch_px or None)
    type_of = None
    if camera is not None and len(camera.lattice.types) == 3:
        type_of = classify_lens_types(bright, fit, expected_blur(camera)).type_of
    rows, columns = next(iter(planes.values())).shape
    top, left = reading.origin or (0, 0)
    lit = {name: plane[top : top + rows, left : left + columns] for name, plane in light.items()}
    return ViewedFrame(planes, cropped(fit, (rows, columns), reading.origin), source, type_of, fit.dead_lenslets, lit)


TYPES = ("none", "together", "each")
SLOPES = {"none": "-6:6:2", "together": "2:6:0.5", "each": "2:6:0.5"}
"""Default slopes of the focal stack. Lens types cannot show planes near the lenslets, whose slopes are small."""


def command(
    context: typer.Context,
    frame: Path = typer.Argument(..., help="Light-field frame: TIFF, PNG, NPY or camera RAW."),
    *,
    white: Path | None = typer.Option(
        None,
        help="White image of the same camera, from which the lattice and the weights of the pixels are determined.",
    ),
    lattice: Path | None = typer.Option(
        None, help="lattice.json of `lfcal white`, used instead of fitting the lattice."
    ),
    camera: str = typer.Option(
        "",
        help="Camera (preset, JSON, Raytrix XML). It states the lattice if --white and --lattice are not given; "
        "--depths and --types require a camera.",
    ),
    dark: Path | None = typer.Option(
        None, help="Dark frame, or a folder of them to average, to subtract from frame and white image."
    ),
    origin: OriginOption = "",
    mask: MaskOption = None,
    kind: str = typer.Option(
        "", help="Kind of lattice in --white: square or hexagonal; default: from the camera, else detected."
    ),
    pitch: float = typer.Option(0.0, help="Nominal pitch in --white (px), accurate to 10 %; default: detected."),
    axes: str = typer.Option(
        "frame",
        help="Direction of the pixel rows in each view: frame (views are upright) or lattice (views are rotated "
        "with the lattice).",
    ),
    full: bool = typer.Option(
        False,
        "--full",
        help="Write the whole field, with NaN where nothing is seen; default: the largest box without NaN.",
    ),
    types: str = typer.Option(
        "none", help="Lens types: none, together (the sharpest have the largest weight), or each (separately)."
    ),
    channel: str = typer.Option("", help="Channel of colour frames: R, G, B or each; default for a mosaic: all."),
    cfa: str = typer.Option("", help="Colour filters in row-major order, such as GRBG; default: from the file."),
    slopes: str = typer.Option(
        "",
        help="Planes of the focal stack as slopes (approximately virtual depths): a,b,c or start:stop:step; default: "
        "-6:6:2, with lens types 2:6:0.5.",
    ),
    depths: str = typer.Option(
        "",
        help="Planes of the focal stack as depths (µm, or with a unit): a,b,c or start:stop:step; needs --camera.",
    ),
    samples: int = typer.Option(4, help="Number of samples of the focal stack per lenslet, along each axis."),
    out: Path | None = typer.Option(None, "-o", "--out", help="Folder for views and focal stacks."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Make sub-aperture views and a focal stack from a light-field frame.

    Example: `lfcal views frame.tif --white white.tif --dark dark.tif -o out`
    """
    from lfcal.frames import parse_origin
    from lfcal.lattice import TOTAL, check_slopes, stack_names, type_lattice, view_names

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
    described = load_camera(camera, light=False) if camera else None
    if types != "none" and (described is None or len(described.lattice.types) != 3):
        raise InputError.expected(
            "--types", "a --camera with three lens types", camera or "none", "give such a camera, or leave --types out"
        )
    if types != "none" and lattice is not None and white is None:
        raise InputError(
            "--types: expected --white in addition to --lattice, got --lattice alone; add --white, or leave --lattice "
            "out: lattice and lens types are then those of --camera"
        )
    check_number("samples per lenslet", samples, at_least=1, at_most=32, integer=True)
    planes = _slopes(slopes or SLOPES[types], depths, described)
    if types != "none":
        check_slopes(planes)
    labels = [f"_type{k}" for k in range(3)] if types == "each" else [""]
    names = [name for label in labels for name in (*view_names(label), *stack_names(label, planes))]
    names += TOTAL if types == "together" else ()
    written = [] if out is None else [out / name for name in names]
    check_outputs(written, frame, white, lattice, dark, camera, mask, force=force)
    reading = ColourReading(channel, cfa, dark, parse_origin(origin), mask, repair=True)
    scene = viewed_frame(frame, GivenLattice(white, lattice, kind, pitch), described, reading)
    lattices = {"": scene.lattice}
    if types == "each" and scene.type_of is not None:
        # each type has its own lattice, but is sampled on the grid of all types
        lattices = {label: type_lattice(scene.lattice, scene.type_of, k) for k, label in enumerate(labels)}
    views = {label: _views(scene, part, axes=axes, full=full, workers=workers) for label, part in lattices.items()}
    if out is not None:
        _save(scene, views, out, planes, types, described, samples=samples, workers=workers)
    facts = {**scene.to_dict(views), "written": written}
    print_result(facts, ["light field", frame.name], scene.rows(views), json=json)
    if not json:
        print_written(*written)


def _slopes(text: str, depths: str, camera: Camera | None) -> tuple[float, ...]:
    from lfcal.lattice import sensor_slope

    if not depths:
        return read_as("--slopes", read_virtual_depths, text)
    if camera is None:
        raise InputError(
            "--depths: expected --camera, which relates depths to slopes, got none; add --camera, or give --slopes "
            "instead"
        )
    return tuple(sensor_slope(camera, z) for z in read_as("--depths", read_depths, depths))


def _views(scene: ViewedFrame, lattice: FrameLattice, **how: Any) -> list[Views]:
    """Return the views of each colour."""
    from lfcal.lattice import TypeLattice, extract_views

    missing = lattice.among(scene.missing) if isinstance(lattice, TypeLattice) else scene.missing
    raster = None if lattice is scene.lattice else scene.lattice
    return [
        extract_views(plane, lattice, missing=missing, raster=raster, **light, **how) for plane, light in scene.read()
    ]


def _save(
    scene: ViewedFrame,
    views: dict[str, list[Views]],
    out: Path,
    slopes: tuple[float, ...],
    types: str,
    camera: Camera | None,
    *,
    samples: int,
    workers: int | None,
) -> None:
    """Write views, focal stacks and, for lens types together, the all-in-focus image."""
    import numpy as np

    from lfcal.lattice import (
        refocus,
        render,
        save_focal_stack,
        save_total_focus,
        save_views,
        sharpness_shares,
        total_focus,
    )

    for k, (label, colours) in enumerate(views.items()):
        save_views(out, label, colours, samples)
        if types == "none":
            stack = [refocus(one, slopes, samples=samples) for one in colours]
        else:
            assert camera is not None  # lens types require a camera
            single, together = np.eye(3)[k], types == "together"
            how: dict[str, Any] = {
                "type_of": scene.type_of,
                "shares": [sharpness_shares(camera, slope) if together else single for slope in slopes],
                "samples": samples,
                "workers": workers,
            }
            rendered = [render(plane, scene.lattice, slopes, **light, **how) for plane, light in scene.read()]
            stack = [one.images for one in rendered]
            if together:
                save_total_focus(out, [total_focus(one) for one in rendered])
        save_focal_stack(out, label, stack, slopes)
