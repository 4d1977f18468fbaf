"""``lfcal white``: measure the lenslet lattice from a white image."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, write_text
from lfcal.cli._console import print_result, print_written
from lfcal.cli._options import ForceOption, JsonOption, MaskOption, WorkersOption
from lfcal.multiplex import read_white
from lfcal.tasks import check_outputs, load_camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.camera import Camera
    from lfcal.lattice import LatticeErrors, LatticeFit, LensTypes, Vignetting

OF_DISCS = ("sensor.shape", "sensor.pixel_um", "lattice.offset_um")
"""Values of a Fourier light-field microscope on which the measured centres of its lenslets depend."""


def command(
    image: Path = typer.Argument(..., help="White image: TIFF, PNG, NPY or camera RAW."),
    *,
    dark: Path | None = typer.Option(None, help="Dark frame to subtract, or a folder of them to average."),
    camera: str = typer.Option("", help="Camera (preset, JSON, Raytrix XML) whose lattice is measured."),
    kind: str = typer.Option(
        "", help="Kind of lattice: square (also rectangular) or hexagonal; default: from the camera, else detected."
    ),
    pitch: float = typer.Option(0.0, help="Nominal pitch (px), accurate to 10 %; default: detected."),
    channel: str = typer.Option(
        "", help="Channel of a colour image: R, G or B; default for a mosaic: the mean of its colours."
    ),
    cfa: str = typer.Option(
        "", help="Colour filters in row-major order, such as GRBG; default: from the file or the camera."
    ),
    mask: MaskOption = None,
    types: bool = typer.Option(True, help="Find the three lens types, if the camera has them."),
    out: Path | None = typer.Option(
        None, "-o", "--out", help="Folder for lattice.json, residuals and, with --camera, camera.json."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure the lenslet lattice from a white image; `lfcal views` then makes views of a frame with it.

    With a Fourier light-field microscope as --camera, the centres of its lenslets are measured instead.

    Example: `lfcal white white.tif --dark dark.tif --camera r29 -o out`
    """
    from lfcal.lattice import (
        classify_lens_types,
        expected_blur,
        fit_lattice,
        lattice_dict,
        lattice_files,
        save_lattice,
        vignetting_map,
    )

    described = load_camera(camera, light=False, without_lattice=OF_DISCS) if camera else None
    if out is not None:
        in_pupil = described is not None and not described.has_lattice
        made = [*([] if in_pupil else lattice_files(out)), *([] if described is None else [out / "camera.json"])]
        check_outputs(made, image, dark, camera, mask, force=force)
    pattern = cfa or (described.sensor.cfa if described is not None else "")
    light = read_white(image, dark, channel, pattern, mask=mask)
    if described is not None and not described.has_lattice:
        _check_discs(kind, pitch)
        _discs(light, described, image, out, json=json)
        return
    wanted = kind or (described.lattice.kind if described is not None else None)
    fit = fit_lattice(light, kind=wanted, pitch_px=pitch or None)
    fall, found = vignetting_map(fit), None
    if types and described is not None and len(described.lattice.types) == 3:
        found = classify_lens_types(light, fit, expected_blur(described))
    if described is not None:
        lattice = fit.to_lattice(described) if found is None else found.to_lattice(fit, described)
        described = replace(described, lattice=lattice)
    written = [] if out is None else save_lattice(fit, out)
    if out is not None and described is not None:
        written.append(out / "camera.json")
        write_text(written[-1], described.to_json())
    facts = {**lattice_dict(fit), "falloff": fall.falloff, "scatter": fall.scatter, "lens_types": found}
    facts |= {"camera": described and described.to_dict(), "written": written}
    print_result(facts, ["white image", image.name], _rows(fit, fall, found), json=json)
    if not json:
        print_written(*written)


def _check_discs(kind: str, pitch: float) -> None:
    """Raise `InputError` if an option is given that applies only to a lattice."""
    for name, given in (("--kind", bool(kind)), ("--pitch", bool(pitch))):
        if given:
            got = "a Fourier light-field microscope"
            raise InputError.expected(name, "a camera with a periodic lenslet array", got, f"leave {name} out")


def _discs(light: NDArray[Any], described: Camera, image: Path, out: Path | None, *, json: bool) -> None:
    """Measure the centres of the lenslets of a Fourier light-field microscope, and write the camera with them."""
    from lfcal.lattice import fit_discs

    found, written = fit_discs(light, described), []
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        written = [out / "camera.json"]
        write_text(written[0], found.camera.to_json())
    facts = {"centres_px": found.centres_px, "errors_px": found.errors_px, "radii_px": found.radii_px}
    rows = [
        [f"lenslet {k}", f"row {row:.3f}, column {column:.3f} ± {error:.3f} px, radius {radius:.1f} px"]
        for k, ((row, column), error, radius) in enumerate(
            zip(found.centres_px.tolist(), found.errors_px, found.radii_px, strict=True)
        )
    ]
    values = {**facts, "camera": found.camera.to_dict(), "written": written}
    print_result(values, ["white image", image.name], rows, json=json)
    if not json:
        print_written(*written)


def _rows(fit: LatticeFit, fall: Vignetting, types: LensTypes | None) -> list[list[str]]:
    row, column = fit.origin_px
    errors: LatticeErrors | None = fit.errors
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
        *_distortion_rows(fit),
        ["residual of the micro-images", f"{fit.residual_rms_px:.3f} px rms per axis"],
        ["lenslets", f"{len(fit.index)}, {int(fit.dead.sum())} of them dead"],
        ["measured in", _extent(fit)],
        ["light at the dimmest point", f"{100 * fall.falloff:.1f} % of the brightest"],
        ["variation between lenslets", f"{100 * fall.scatter:.2f} % rms"],
    ]
    if types is not None:
        rows += [
            ["lens types", f"type 0 where (q - r) mod 3 = {types.phase}, type {types.type_step} to the right of it"],
            ["  confidence", f"{types.sigmas:.0f} standard errors, {100 * types.agreement:.0f} % of places agree"],
        ]
    return rows + [["note", note] for note in fit.notes]


def _extent(fit: LatticeFit) -> str:
    """Return the rows and columns of the outline of the lenslets used."""
    assert fit.outline_px is not None  # a fit of a white image states it
    (top, left), (bottom, right) = fit.outline_px.min(0), fit.outline_px.max(0)
    return f"rows {top:.0f} to {bottom:.0f}, columns {left:.0f} to {right:.0f}; corners of its outline in lattice.json"


def _distortion_rows(fit: LatticeFit) -> list[list[str]]:
    """Return the effect of the distortion on the frame; its coefficients are in ``lattice.json`` and ``--json``."""
    import numpy as np

    if fit.distortion is None:
        return []
    q, r = fit.index.T
    pitches = np.hypot(*(fit.centres_px(q + 1, r) - fit.centres_px(q, r)).T)
    middle = np.hypot(*(fit.centres_px(1, 0) - fit.centres_px(0, 0)))
    points = fit.centres_px(q, r)[:, ::-1]
    displaced = np.hypot(*(points - fit.distortion.invert(points)).T)
    return [
        ["pitch at the centre", f"{middle:.4f} px"],
        ["pitch over the field", f"{pitches.min():.4f} to {pitches.max():.4f} px"],
        ["largest distortion", f"{displaced.max():.2f} px"],
    ]
