"""Export of H as a command. No Qt."""

from __future__ import annotations

from lfcal.base import InputError
from lfcal_gui.models import CommandStep, ProjectState, needed_file, options_of
from lfcal_gui.pages.psf.export_model import ExportIntent

__all__ = ["step"]


def step(project: ProjectState, out: str = "", intent: ExportIntent | None = None) -> CommandStep:
    """Return how H is exported: for MATLAB where nothing else was asked for."""
    psf, out = needed_file(project.psf, "H", "PSF"), out or "H.mat"
    intent = intent or ExportIntent.of_path(out)
    chosen = intent.options
    if chosen.dtype is not None:
        raise InputError.expected("samples", "as they are", "16-bit", "the command writes no others")
    transposed = intent.transposed and intent.suffix != ".mat"
    place = "" if chosen.position is None else "{},{}".format(*chosen.position)
    pairs = (
        ("--out", out),
        ("--transposed", transposed),
        ("--no-ht", chosen.include_transpose is False),
        ("--rows-first", chosen.rows_first),
        ("--lens-centred", chosen.lens_centred),
        ("--interpolation", chosen.interpolation),
        ("--uncompressed", chosen.compress is False),
        ("--position", place),
        ("--allow-missing", chosen.allow_missing),
    )
    given = "".join(f", {name}={value!r}" for name, value in chosen.given().items())
    python = f"""
from lfcal.psf import export, open_psf

with open_psf({psf!r}) as H:
    print(H.shape, H.depths, H.T[0, 0, 0].sum())
    export(H{".T" if transposed else ""}, {out!r}{given})
"""
    return CommandStep(("export", psf, *options_of(pairs)), python)
