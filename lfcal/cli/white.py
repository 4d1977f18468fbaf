"""``lfcal white``: the lenslet lattice from a white image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import replace_whole
from lfcal.camera import Camera
from lfcal.cli._colour_planes import read_white
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption
from lfcal.cli._white_files import LATTICE, RESIDUAL_MAP, RESIDUALS, lattice_dict, save_lattice
from lfcal.tasks import check_outputs, load_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.lattice import LatticeErrors, LatticeFit, LensTypes, Vignetting

__all__ = ["register"]

CAMERA = "camera.json"


@dataclass(frozen=True)
class _White:
    """A white image less its dark frame, and the camera it is of, where that is described."""

    image: NDArray[Any]
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
    from lfcal.camera import polynomial_powers

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


def _types(white: NDArray[Any], fit: LatticeFit, camera: Camera | None) -> LensTypes | None:
    from lfcal.lattice import classify_lens_types, expected_blur

    if camera is None or len(camera.lattice.types) != 3:
        return None
    return classify_lens_types(white, fit, expected_blur(camera))


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
    dark: Path | None = typer.Option(None, help="Dark frame, or a folder of them to average; subtracted."),
    camera: str = typer.Option("", help="Camera (preset, JSON, Raytrix XML) whose lattice is measured."),
    kind: str = typer.Option("", help="square or hexagonal; by default detected, or the camera's."),
    pitch: float = typer.Option(0.0, help="Nominal pitch (px), right within 10 %; by default detected."),
    channel: str = typer.Option(
        "", help="Of a colour image: R, G or B; of a mosaic the mean of its colours by default."
    ),
    cfa: str = typer.Option(
        "", help="Colour filters of a mosaic by rows, e.g. GRBG; by default the file's or camera's."
    ),
    types: bool = typer.Option(True, help="Find the three lens types, where the camera has them."),
    out: Path | None = typer.Option(None, "-o", "--out", help="Folder for lattice.json, residuals and camera.json."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure the lenslet lattice from a white image; see with `lfcal views` what it makes of a frame.

    Example: `lfcal white white.tif --dark dark.tif --camera r29 -o out`
    """
    described = load_camera(camera) if camera else None
    if out is not None:
        names = [LATTICE, RESIDUALS, RESIDUAL_MAP, *([] if described is None else [CAMERA])]
        check_outputs([out / name for name in names], image, dark, camera, force=force)
    filters = cfa or (described.sensor.cfa if described is not None else "")
    found = _measure(_White(read_white(image, dark, channel, filters), described), kind, pitch, types)
    written = [] if out is None else save_lattice(found.fit, out)
    if out is not None and found.camera is not None:
        written.append(_save_camera(found.camera, out))
    if json:
        print_json({**_as_json(found.fit, found.fall, found.types, found.camera), "written": written})
        return
    print_table(["white image", str(image.name)], _rows(found.fit, found.fall, found.types))
    for path in written:
        typer.echo(f"written: {path}")


def _measure(white: _White, kind: str, pitch: float, types: bool) -> _Found:
    """Return the lattice of the white image; ``kind`` and ``pitch`` (px) where they are known beforehand."""
    from lfcal.lattice import fit_lattice, vignetting_map

    camera = white.camera
    wanted = kind or (camera.lattice.kind if camera is not None else None)
    fit = fit_lattice(white.image, kind=wanted, pitch_px=pitch or None)
    found = _types(white.image, fit, camera) if types else None
    measured = None if camera is None else _measured(camera, fit, found)
    return _Found(white, fit, vignetting_map(fit), found, measured)
