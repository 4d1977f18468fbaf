"""A reconstruction as a command. No Qt."""

from __future__ import annotations

from dataclasses import asdict

from lfcal.base import InputError
from lfcal.reconstruct import SolverChoice
from lfcal.reconstruct.solvers import GOALS, STOPS
from lfcal_gui.models import CommandStep, ProjectState, needed_file, options_of
from lfcal_gui.pages.reconstruct.model import ReconstructSettings

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the light field becomes a volume."""
    psf = needed_file(project.psf, "H", "PSF")
    frame, chosen = needed_file(project.light_field, "light field", "Reconstruct"), ReconstructSettings.of(project)
    if chosen.region:
        raise InputError.expected("region", "the whole light field", chosen.region, "a command takes all of it")
    choice, out = chosen.choice(), out or "volume.tif"
    pairs = (
        ("--solver", choice.name),
        ("--iterations", _iterations(choice)),
        ("--goal", choice.goal if choice.goal != GOALS[0] else None),
        ("--gain", choice.gain),
        ("--method", chosen.method),
        ("--device", chosen.device if chosen.device != "auto" else None),
        ("--threshold", chosen.threshold or None),
        ("--within", chosen.within or None),
        ("--margin", "auto" if chosen.margin is None else str(choice.margin)),
        ("--anchor", ",".join(f"{v!r}" for v in chosen.anchor)),
        ("--background", choice.background or None),
        ("--read-noise", choice.read_noise or None),
        ("--saturation", choice.saturation),
        ("--strength", choice.strength),
        ("--subsets", choice.subsets),
        ("--voxel", chosen.voxel),
        ("--double", chosen.double),
        ("--as-is", chosen.as_is),
        ("--out", out),
    )
    return CommandStep(("reconstruct", psf, frame, *options_of(pairs)), _python(psf, frame, chosen, out))


def _iterations(choice: SolverChoice) -> str:
    if not choice.auto:
        return str(choice.iterations)
    return "auto" if choice.stop == STOPS[0] else f"auto:{choice.stop}"


RESAMPLED = """
    anchor, weights = H.anchor, None
    if (view := resampling_for(H, image.shape)) is not None:
        anchor, weights, image = view.anchor(lattice_anchor_of(H)), view.inside(image.shape), view.apply(image)"""
"""Lines of a script that resample a frame whose lattice drifts against H's period."""


def _python(psf: str, frame: str, chosen: ReconstructSettings, out: str) -> str:
    choice = chosen.choice()
    settings = {key: value for key, value in asdict(choice).items() if key != "margin"}
    usual = "usual_margin(H.period, H.shape[3:], image.shape)"
    stated = repr(tuple(chosen.anchor)) if chosen.anchor else ""
    resampled, row_column, anchor, weights = "", stated or "H.anchor", stated or "None", ""
    if not (chosen.as_is or chosen.anchor):
        resampled, row_column, anchor, weights = RESAMPLED, "anchor", "anchor", ", weights=weights"
    grid, placed = "", "volume"
    if chosen.voxel:
        side = "None" if chosen.voxel == "auto" else chosen.voxel
        grid = f"\n    grid = MetricGrid.for_matrix(H, (rows, columns), {anchor}, {side})"
        placed = "grid.apply(volume)"
    return f"""
import numpy as np
import tifffile
from lfcal.psf import open_psf
from lfcal.reconstruct import (
    MetricGrid, Projector, SolverChoice, lattice_anchor_of, reconstruct, resampling_for, usual_margin
)

image = tifffile.imread({frame!r}).astype(np.float32)
with open_psf({psf!r}) as H:{resampled}
    margin = {usual if chosen.margin is None else choice.margin}
    choice = SolverChoice(**{settings!r}, margin=margin)
    row, column = {row_column}
    rows, columns = image.shape
    projector = Projector(
        H, (rows + 2 * margin, columns + 2 * margin), (row + margin, column + margin), {chosen.method!r},
        dtype={"float64" if chosen.double else "float32"!r}, threshold={chosen.threshold!r},
        tolerance={chosen.within!r}, device={chosen.device!r},
    )
    volume = reconstruct(projector, image, choice{weights}).volume{grid}
    tifffile.imwrite({out!r}, np.asarray({placed}, np.float32))
"""
