"""Options that several commands share, each defined once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from lfcal.base import bounded_threads

__all__ = [
    "MATRICES",
    "CameraArgument",
    "Chi2Option",
    "ExposureOption",
    "ForceOption",
    "GainOption",
    "JsonOption",
    "MaskOption",
    "MatOrderOption",
    "OriginOption",
    "PageOption",
    "PresetOption",
    "UncorrectedOption",
    "WorkersOption",
]


MATRICES = (".h5", ".hdf5", ".mat", ".npy", ".lfc")
"""Suffixes of H files, for arguments that also accept a camera or a plan."""


def _presets(incomplete: str) -> list[str]:
    """Return the presets that shell completion offers for a camera; it offers files if no preset matches."""
    from lfcal.camera import PRESETS

    return [name for name in PRESETS if name.startswith(incomplete)]


def _mat_orders(incomplete: str) -> list[str]:
    from lfcal.psf import MAT_ORDERS

    return [name for name in MAT_ORDERS if name.startswith(incomplete)]


def _bound(context: typer.Context, workers: int | None) -> int | None:
    """Limit the threads of a command, including those of libraries, until it ends."""
    if workers is not None:
        context.with_resource(bounded_threads(workers))
    return workers


JsonOption: TypeAlias = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]

WorkersOption: TypeAlias = Annotated[
    int | None,
    typer.Option(
        "--workers", min=1, callback=_bound, help="Number of threads; default: LFCAL_WORKERS, else one per processor."
    ),
]

ForceOption: TypeAlias = Annotated[bool, typer.Option("--force", help="Replace existing files.")]
"""Option to replace existing files; without it, a command ends before its work if a file exists (`check_outputs`)."""

MatOrderOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--mat-order",
        autocompletion=_mat_orders,
        help="Order of the axes of H in a .mat file that does not state the order: rows-first, H(t,s,y,x,z), or "
        "columns-first, "
        "H(s,t,x,y,z). Default: inferred from its variables.",
    ),
]

CameraArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        autocompletion=_presets,
        help="Preset, or camera file: camera.json, Raytrix XML, oLaF YAML, napari-LF metadata …",
    ),
]

MaskOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        help="Pixels to interpolate: an image that is not 0 at these pixels, or a list with one ROW,COLUMN per line. "
        "NaN is always interpolated.",
    ),
]

OriginOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--origin",
        metavar="ROW,COLUMN",
        help="Sensor row and column of the first pixel, for frames that show a part of the sensor.",
    ),
]

PageOption: TypeAlias = Annotated[
    int, typer.Option("--page", min=0, help="Page of a file with several frames, starting at 0.")
]

Chi2Option: TypeAlias = Annotated[
    float | None,
    typer.Option("--chi2", min=0, help="Ratio of photon-noise variance to additive-noise variance at full scale."),
]
"""Option for the noise ratio, which decides which modulator is best."""

PresetOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--camera", help="Preset or camera file, instead of --chi2: chi^2 is computed from its full well and its noise."
    ),
]

GainOption: TypeAlias = Annotated[
    float, typer.Option("--gain", help="Amplifier gain as a factor: full scale is the full well divided by the gain.")
]
"""Option for the amplifier gain at which the full scale and the noise of the sensor are computed."""

ExposureOption: TypeAlias = Annotated[
    float, typer.Option("--exposure", min=0, help="Exposure time (s), for the dark current.")
]

UncorrectedOption: TypeAlias = Annotated[
    bool, typer.Option("--uncorrected", help="Use the noise of frames that are not divided by a white image.")
]
