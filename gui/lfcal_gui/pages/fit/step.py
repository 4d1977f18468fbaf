"""A fit as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import CAMERA_FILE, CommandStep, ProjectState, needed_file, options_of
from lfcal_gui.pages.fit.model import FitSettings

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the camera is fitted to H."""
    psf, chosen = needed_file(project.psf, "H", "PSF"), FitSettings.of(project)
    folder = out or "fit"
    own, unknowns, noise = chosen.camera == "psf", chosen.unknowns, chosen.noise
    pairs = (
        ("--camera", "" if own else CAMERA_FILE),
        ("--positions", chosen.positions),
        ("--unknowns", unknowns if isinstance(unknowns, str) else ",".join(unknowns)),
        ("--noise", "" if noise is None else f"{noise[0]!r},{noise[1]!r}"),
        ("--out", folder),
    )
    camera = "None" if own else f'Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))'
    python = f"""
from lfcal.camera import Camera
from lfcal.fit import fit_camera
from lfcal.psf import open_psf

with open_psf({psf!r}) as H:
    fit = fit_camera(H, {camera}, {unknowns!r}, most={chosen.positions or None!r}, noise={noise!r})
    print(fit.verdict)
    Path({folder!r}).mkdir(parents=True, exist_ok=True)
    Path({folder!r}, "camera.json").write_text(fit.camera.to_json(), encoding="utf-8")
"""
    return CommandStep(
        ("fit", psf, *options_of(pairs)), python, () if own else ((CAMERA_FILE, project.camera.to_json()),)
    )
