"""``python -m benchmarks lattice``: fitted lattices of distorted arrays, compared with the true ones."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

from benchmarks._white_cameras import COUNT, WhiteCamera, white_camera
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    from lfcal.lattice import LatticeFit

BOUND_PX = 0.05


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of the fit for one camera.

    Attributes
    ----------
    rms_px, largest_px
        Rms and largest distance between fitted and true centres of all lenslets in the frame (px).
    pull
        Rms of the distances in units of their standard errors: 1 if the stated errors are correct.
    """

    camera: int
    kind: str
    pitch_px: float
    turn_deg: float
    called: str
    form: str
    rms_px: float
    largest_px: float
    pull: float
    seconds: float


def register(bench: typer.Typer) -> None:
    """Add ``lattice`` to the benchmarks."""
    bench.command("lattice")(command)


def command(
    *,
    cameras: int = typer.Option(COUNT, min=1, help="Number of cameras; every fourth repeats kind and distortion."),
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Fit white images of distorted arrays: square and hexagonal, rotated by up to 45°, SNR 20, 5 % dead lenslets.

    Example: `python -m benchmarks lattice --cameras 4`
    """
    trials = [measure(number, workers) for number in range(cameras)]
    if json:
        print_json(trials)
    else:
        _show(trials)


def measure(number: int, workers: int | None) -> Trial:
    """Return the result of the fit for camera ``number``."""
    from lfcal.lattice import fit_lattice

    camera = white_camera(number)
    start = time.perf_counter()
    fit = fit_lattice(camera.frame, pitch_px=camera.nominal_px, workers=workers)
    took = time.perf_counter() - start
    rms, largest, pull = _against(fit, camera)
    turn = math.degrees(camera.turn_rad)
    return Trial(number, camera.kind, camera.pitch_px, turn, camera.called, fit.form, rms, largest, pull, took)


def _against(fit: LatticeFit, camera: WhiteCamera) -> tuple[float, float, float]:
    """Return rms and largest distance of the fitted lenslets from the true ones, and the pull of the parameters."""
    import numpy as np
    from scipy.spatial import cKDTree

    from lfcal.lattice._forms import FORMS, DistortionFrame, design

    fitted = fit.centres_px(fit.index[:, 0], fit.index[:, 1])[:, ::-1]
    true = camera.places[cKDTree(camera.places).query(fitted)[1]]
    off = fitted - true
    distance = np.hypot(*off.T)
    assert fit.errors is not None
    form = next(form for form in FORMS if form.name == fit.form)
    columns = design(fit.model, form, fit.index, DistortionFrame.of(fit.shape)).reshape(-1, form.size)
    # the parameters that correspond to the distances, whitened with their covariance
    size = np.sqrt(np.diag(fit.errors.covariance))
    numbers = np.linalg.lstsq(columns * size, off.T.ravel(), rcond=None)[0]
    correlation = fit.errors.covariance / size / size[:, None]
    pull = math.sqrt(float(numbers @ np.linalg.solve(correlation, numbers)) / form.size)
    return math.sqrt(float((distance**2).mean())), float(distance.max()), pull


def _show(trials: list[Trial]) -> None:
    rows = [
        [
            str(t.camera),
            f"{t.kind}, {t.pitch_px:.2f} px, {t.turn_deg:+.1f}°",
            t.called,
            t.form,
            f"{t.rms_px:.4f}",
            f"{t.largest_px:.4f}",
            f"{t.pull:.2f}",
            f"{t.seconds:.2f}",
        ]
        for t in trials
    ]
    mean = math.sqrt(sum(t.pull**2 for t in trials) / len(trials))
    right = sum(t.form == t.called for t in trials)
    title = f"{right} of {len(trials)} with the form drawn; bound {BOUND_PX} px rms; pull {mean:.2f} rms"
    headers = ["", "array", "drawn", "form chosen", "rms (px)", "largest (px)", "pull", "seconds"]
    print_table(headers, rows, title=title)
