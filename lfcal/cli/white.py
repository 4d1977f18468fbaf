"""``lfcal white``: the lenslet lattice from a white image, and a look at what it makes of a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.camera import Camera
from lfcal.cli.console import print_json, print_table
from lfcal.cli.options import ForceOption, JsonOption, WorkersOption
from lfcal.cli.outputs import check_outputs
from lfcal.cli.plan import load_camera, parse_depths
from lfcal.cli.white_files import LATTICE, RESIDUAL_MAP, RESIDUALS, lattice_dict, save_lattice
from lfcal.errors import InputError
from lfcal.files import replace_whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.lattice.fit import LatticeFit
    from lfcal.lattice.lattice_fit import LatticeErrors
    from lfcal.lattice.lens_types import LensTypes
    from lfcal.lattice.views import Views
    from lfcal.lattice.vignetting import Vignetting

__all__ = ["register"]

CAMERA = "camera.json"
PICTURES = ("views.png", "central_view.png", "focal_stack.tif")


@dataclass(frozen=True)
class _White:
    """A white image, its dark level (counts), and the camera it is of, where that is described."""

    image: NDArray[Any]
    dark: NDArray[Any] | float
    camera: Camera | None


@dataclass(frozen=True)
class _Found:
    """What a white image tells: lattice, fall of light, lens types, and the camera with the lattice measured."""

    white: _White
    fit: LatticeFit
    fall: Vignetting
    types: LensTypes | None
    camera: Camera | None


def _rows(fit: LatticeFit, fall: Vignetting, types: LensTypes | None) -> list[list[str]]:
    row, column = fit.origin_px
    errors = fit.errors
    assert errors is not None  # a fit of a white image states them
    rows = [
        ["lattice", fit.kind],
        ["model", fit.reason],
        ["pitch along a row", f"{fit.pitch_px:.4f} ± {fit.pitch_error_px:.4f} px"],
        ["distance of rows", f"{fit.row_pitch_px:.4f} ± {errors.row_pitch_px:.4f} px"],
        ["rotation", f"{math.degrees(fit.rotation_rad):+.4f} ± {math.degrees(errors.rotation_rad):.4f}°"],
        [
            "departure from the ideal angle",
            f"{math.degrees(fit.shear_rad):+.4f} ± {math.degrees(errors.shear_rad):.4f}°",
        ],
        ["centre of the middle lenslet", f"row {row:.3f}, column {column:.3f}"],
        *_distortion_rows(fit, errors),
        ["distance of micro-images from it", f"{fit.residual_rms_px:.3f} px rms per axis"],
        ["lenslets", f"{len(fit.index)}, {int(fit.dead.sum())} of them dead"],
        ["light at the dimmest place", f"{100 * fall.falloff:.1f} % of the brightest"],
        ["lenslet to lenslet", f"{100 * fall.scatter:.2f} % rms"],
    ]
    if types is not None:
        rows += [
            ["lens types", f"type 0 where (q - r) mod 3 = {types.phase}, type {types.type_step} to the right of it"],
            ["  confidence", f"{types.sigmas:.0f} standard errors, {100 * types.agreement:.0f} % of places agree"],
        ]
    return rows + [["doubtful", note] for note in fit.notes]


def _distortion_rows(fit: LatticeFit, errors: LatticeErrors) -> list[list[str]]:
    """Return the distortion's numbers with their errors: displacements at the length scale from its centre."""
    from lfcal.camera.distortion import polynomial_powers

    bend = fit.distortion
    if bend is None:
        return []
    x, y = bend.centre
    dx, dy = errors.centre
    names = [f"k{n + 1}" for n in range(len(bend.terms[0]))]
    if bend.model == "polynomial":
        names = [f"u^{i} v^{j}" for i, j in polynomial_powers(bend.degree)]
    rows = [["distortion", f"up to {bend.largest:.2f} px within {bend.scale:.0f} px of its centre"]]
    if bend.model == "radial":
        rows.append(["  centre", f"row {y:.1f} ± {dy:.1f}, column {x:.1f} ± {dx:.1f}"])
    for axis, line, sigmas in zip(("to the right", "down"), bend.terms, errors.terms, strict=False):
        name = "outwards" if bend.model == "radial" else axis
        shown = "; ".join(f"{n} {t:+.3f} ± {e:.3f}" for n, t, e in zip(names, line, sigmas, strict=True))
        rows.append([f"  {name} (px)", shown])
    return rows


def _as_json(fit: LatticeFit, fall: Vignetting, types: LensTypes | None, camera: Camera | None) -> dict[str, Any]:
    return {
        **lattice_dict(fit),
        "falloff": fall.falloff,
        "scatter": fall.scatter,
        "lens_types": types,
        "camera": camera.to_dict() if camera is not None else None,
    }


def _save_views(views: Views, slopes: tuple[float, ...], samples: int, out: Path) -> list[Path]:
    """Write the views side by side, the middle view and the focal stack as PNG, and the stack as float32 TIFF."""
    from lfcal.figures import save_array_png
    from lfcal.lattice.views import refocus
    from lfcal.tiff_file import write_tiff

    stack = refocus(views, slopes, samples=samples)
    written = [out / name for name in PICTURES]
    save_array_png(_shown(views.mosaic(2), 1), written[0], cmap="gray")
    save_array_png(_shown(views.central, samples), written[1], cmap="gray")
    write_tiff(written[2], stack, metadata={"axes": "ZYX", "slopes": list(slopes)})
    for slope, image in zip(slopes, stack, strict=True):
        written.append(out / _focused(slope))
        save_array_png(_shown(image, 1), written[-1], cmap="gray")
    return written


def _focused(slope: float) -> str:
    return f"focus_{slope:+07.2f}.png"


def _targets(out: Path, camera: Camera | None, views: Path | None, slopes: tuple[float, ...]) -> list[Path]:
    """Return the files that will be written."""
    names = [LATTICE, RESIDUALS, RESIDUAL_MAP, *([] if camera is None else [CAMERA])]
    names += [] if views is None else [*PICTURES, *map(_focused, slopes)]
    return [out / name for name in names]


def _shown(image: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Return ``image`` between its 0.5 and 99.7 percentiles, each pixel ``times`` as wide and high."""
    import numpy as np

    # Hot pixels and dead lenslets would otherwise decide the scale of the picture.
    low, high = np.percentile(image, (0.5, 99.7))
    clipped = np.clip(image - low, 0, max(high - low, 1e-30))
    result: NDArray[np.float32] = clipped.repeat(times, axis=0).repeat(times, axis=1)
    return result


def _slopes(text: str, depths: str, camera: Camera | None) -> tuple[float, ...]:
    from lfcal.lattice.views import sensor_slope

    if depths and camera is None:
        raise InputError("depths: need --camera to know where they are focused; give it, or --slopes instead")
    if depths and camera is not None:
        return tuple(sensor_slope(camera, z) for z in parse_depths(depths, lengths=True))
    return parse_depths(text, lengths=False)


def _types(white: NDArray[Any], dark: Any, fit: LatticeFit, camera: Camera | None) -> LensTypes | None:
    from lfcal.lattice.lens_types import classify_lens_types, expected_blur

    if camera is None or len(camera.lattice.types) != 3:
        return None
    return classify_lens_types(white, fit, expected_blur(camera), dark=dark)


def _measured(camera: Camera, fit: LatticeFit, types: LensTypes | None) -> Camera:
    lattice = fit.to_lattice(camera) if types is None else types.to_lattice(fit, camera)
    return replace(camera, lattice=lattice)


def _save_camera(camera: Camera, out: Path) -> Path:
    path = out / CAMERA
    with replace_whole(path) as part:
        part.write_text(camera.to_json(), encoding="utf-8")
    return path


def register(app: typer.Typer) -> None:
    """Add ``white`` to the app."""
    app.command("white")(command)


def command(
    image: Path = typer.Argument(..., help="White image: TIFF, PNG, NPY or camera RAW."),
    *,
    dark: Path | None = typer.Option(None, help="Dark frame, subtracted."),
    camera: str = typer.Option("", help="Camera (preset, JSON, Raytrix XML) whose lattice is measured."),
    kind: str = typer.Option("", help="square or hexagonal; by default detected, or the camera's."),
    pitch: float = typer.Option(0.0, help="Nominal pitch (px), right within 10 %; by default detected."),
    types: bool = typer.Option(True, help="Find the three lens types, where the camera has them."),
    views: Path | None = typer.Option(None, help="Light-field frame to make views and a focal stack of."),
    slopes: str = typer.Option("-6:6:2", help="Planes of the focal stack as slopes (about virtual depths)."),
    depths: str = typer.Option("", help="The same as depths in µm or mm; needs --camera."),
    samples: int = typer.Option(4, help="Samples per lenslet of the focal stack."),
    out: Path | None = typer.Option(
        None, "-o", "--out", help="Folder for lattice.json, residuals, camera.json and pictures."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure the lenslet lattice from a white image; make views of a frame to see that it is right.

    Example: `lfcal white white.tif --dark dark.tif --views frame.tif -o out`
    """
    from lfcal.frames import read_image

    if views is not None and out is None:
        raise InputError("views: need a folder for the pictures; add -o FOLDER")
    described = load_camera(camera) if camera else None
    planes = _slopes(slopes, depths, described)
    if out is not None:
        check_outputs(_targets(out, described, views, planes), image, dark, views, camera, force=force)
    level = read_image(dark) if dark is not None else 0.0
    found = _measure(_White(read_image(image), level, described), kind, pitch, types)
    written = _write(found, views, planes, samples, out)
    if json:
        print_json({**_as_json(found.fit, found.fall, found.types, found.camera), "written": written})
        return
    print_table(["white image", str(image.name)], _rows(found.fit, found.fall, found.types))
    for path in written:
        typer.echo(f"written: {path}")


def _measure(white: _White, kind: str, pitch: float, types: bool) -> _Found:
    """Return the lattice of the white image; ``kind`` and ``pitch`` (px) where they are known beforehand."""
    from lfcal.lattice.fit import fit_lattice
    from lfcal.lattice.vignetting import vignetting_map

    camera = white.camera
    wanted = kind or (camera.lattice.kind if camera is not None else None)
    fit = fit_lattice(white.image, dark=white.dark, kind=wanted, pitch_px=pitch or None)
    found = _types(white.image, white.dark, fit, camera) if types else None
    measured = None if camera is None else _measured(camera, fit, found)
    return _Found(white, fit, vignetting_map(fit), found, measured)


def _write(found: _Found, frame: Path | None, slopes: tuple[float, ...], samples: int, out: Path | None) -> list[Path]:
    """Write the lattice, the measured camera and the views of ``frame`` into ``out``; return the files."""
    from lfcal.frames import read_image
    from lfcal.lattice.views import extract_views

    if out is None:
        return []
    # A frame that does not fit is refused before the first file is written.
    views = None
    if frame is not None:
        views = extract_views(read_image(frame), found.fit, white=found.white.image, dark=found.white.dark)
    # the views first: what they refuse leaves nothing behind
    pictures = [] if views is None else _save_views(views, slopes, samples, out)
    camera = [] if found.camera is None else [_save_camera(found.camera, out)]
    return save_lattice(found.fit, out) + camera + pictures
