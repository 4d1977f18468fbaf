"""``lfcal multiplex coding``: noise gain of lighting several points together, and the code for a display."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from lfcal.base import InputError, check_choice
from lfcal.cli._console import print_result, report
from lfcal.cli._options import (
    MATRICES,
    ExposureOption,
    ForceOption,
    GainOption,
    JsonOption,
    MatOrderOption,
    UncorrectedOption,
    WorkersOption,
)
from lfcal.cli._usage import refuse
from lfcal.multiplex import CODES, is_whole
from lfcal.records import read_as, read_position
from lfcal.tasks import check_mat_files, check_output, check_outputs, open_matrix

if TYPE_CHECKING:
    from lfcal.camera import Camera

__all__ = ["coding"]

EQUAL = {"time": "time", "full_well": "full well"}
"""Quantities that are kept equal between single and coded frames: entries of the JSON output, and words for display."""

TOLERANCE = 0.03
"""Tolerance of the simulated patterns; gains change far less."""


class _Plane(NamedTuple):
    """A plane of patterns ``(ny, nx, nt, ns)``, its depth (µm), its camera if known, and a description."""

    patterns: Any
    depth_um: float
    camera: Camera | None
    words: str


def coding(
    context: typer.Context,
    source: str = typer.Argument(help="H file; or a preset or camera file, whose patterns are simulated."),
    *,
    points: int = typer.Option(7, min=2, max=255, help="Number of points in a block; their patterns overlap."),
    step: int = typer.Option(1, min=1, help="Distance between points, in source positions (px in the image)."),
    at: str = typer.Option("0,0", help="Source position Y,X of the first point."),
    plane: int = typer.Option(0, min=0, help="Number of the plane of the H file, starting at 0."),
    virtual_depth: float | None = typer.Option(
        None, help="With a camera: virtual depth of the simulated plane; default 4."
    ),
    depth: float | None = typer.Option(
        None, help="With a camera: depth of the simulated plane (µm), instead of its virtual depth."
    ),
    code: str = typer.Option("S", help="Code: S (S-matrix), random, or single (one point per frame)."),
    frames: int | None = typer.Option(
        None, min=1, help="Number of frames of a random code; default: the number of points."
    ),
    density: float = typer.Option(0.5, help="Fraction of points that are lit in a random code."),
    seed: int = typer.Option(0, min=0, help="Seed of random codes and of --monte-carlo."),
    signal: float | None = typer.Option(
        None, help="Electrons in the brightest pixel of a single point in one frame; default: the full well."
    ),
    sensor: str | None = typer.Option(
        None, help="Preset or camera file whose sensor to use; default: the camera of SOURCE."
    ),
    gain: GainOption = 1.0,
    exposure: ExposureOption = 0.0,
    uncorrected: UncorrectedOption = False,
    monte_carlo: int = typer.Option(
        0, min=0, help="Number of simulated series of frames on which the gain is also measured; 0: none."
    ),
    display: str | None = typer.Option(None, help="Display to check: COLUMNSxROWS@PITCH in µm, such as 1920x1080@8."),
    patterns: Path | None = typer.Option(
        None, help="With --display: folder for the frames to show (code_000.png …) and code.npy."
    ),
    repeat: int = typer.Option(
        0, min=0, help="With --patterns: repeat the block after this distance (px in the image); 0: show it once."
    ),
    out: Path | None = typer.Option(
        None,
        "--out",
        "-o",
        help="File for plots of the gain of each entry of H, and of the gain as a function of the signal (.png).",
    ),
    mat_order: MatOrderOption = "",
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Report whether lighting several points together reduces noise: the gains of bright and dark entries of H.

    Example: `lfcal multiplex coding H.h5 --points 7 --signal 300 --display 1920x1080@8 --patterns code -o gain.png`
    """
    import numpy as np

    from lfcal.multiplex import (
        code_files,
        code_matrix,
        coding_pays,
        display_fit,
        measured_coding_gain,
        overlapping_patterns,
        save_code,
        save_coding,
        sensor_noise,
    )
    from lfcal.tasks import OF_NOISE, OF_RAW_NOISE, load_camera

    check_choice("code", code, CODES)
    check_output(out, source, sensor, force=force)
    check_mat_files(mat_order, Path(source))
    if code != "random":
        refuse(context, "--code random", f"--code {code}", "density", *(() if monte_carlo else ("seed",)))
    if patterns is None:
        refuse(context, "--patterns", "none", "repeat")
    screen = None if display is None else _display(display)
    rng, first = np.random.default_rng(seed), read_as("--at", read_position, at)
    lit = code_matrix(code, points, frames=frames, density=density, rng=rng)
    if patterns is not None and screen is None:
        raise InputError.expected("display", "a display for --patterns", "none", "add --display, such as 1920x1080@8")
    files = [] if patterns is None else code_files(patterns, len(lit))
    check_outputs(files, source, sensor, force=force)
    if Path(source).suffix.lower() in MATRICES:
        if virtual_depth is not None or depth is not None:
            raise InputError(
                "--depth, --virtual-depth: apply only to a simulated plane; choose a plane of an H file with --plane"
            )
        seen = _stored(Path(source), plane, mat_order)
    else:
        if plane:
            raise InputError.expected("--plane", "an H file", source, "give the plane with --depth or --virtual-depth")
        seen = _simulated(load_camera(source), virtual_depth, depth, first, points, step)
    described = seen.camera if sensor is None else load_camera(sensor, only=OF_RAW_NOISE if uncorrected else OF_NOISE)
    if described is None:
        raise InputError.expected("sensor", "the camera of H, or --sensor", "an H without a camera", "add --sensor")
    noise = sensor_noise(described.sensor, gain=gain, exposure_s=exposure, flat_corrected=not uncorrected)
    light, places = overlapping_patterns(seen.patterns, points, step=step, first=first)
    verdicts = {key: coding_pays(light, noise, code=lit, signal_e=signal, limit=limit) for key, limit in EQUAL.items()}
    found, even = verdicts["time"].gain, verdicts["time"].break_even_e
    facts: dict[str, Any] = {
        "source": seen.words,
        "code": code,
        "points": points,
        "frames": len(lit),
        "signal_e": found.signal_e,
        "full_e": noise.full_e,
        "additive_e2": noise.additive_e2,
        "pays": {key: verdict.pays for key, verdict in verdicts.items()},
        "equal_time": found.time,
        "equal_full_well": found.full_well,
        "break_even_e": even if math.isfinite(even) else None,
        "pays_at_any_light": math.isinf(even),
    }
    if monte_carlo:
        how: dict[str, Any] = {"signal_e": found.signal_e, "trials": monte_carlo, "rng": rng}
        facts["measured_db"] = {
            key: measured_coding_gain(light, lit, noise, limit=limit, **how) for key, limit in EQUAL.items()
        }
    words = [verdict.words for verdict in verdicts.values()]
    if screen is not None:
        if seen.camera is None:
            got = "an H without a camera"
            raise InputError.expected("--display", "an H with its camera", got, "leave --display out")
        shape, pixel_um = screen
        fit = display_fit(seen.camera.step_um(seen.depth_um), pixel_um)
        facts["display"] = {"pixel_um": fit.pixel_um, "needed_um": fit.step_um, "image_px": fit.image_px}
        facts["display"] |= {"placing_px": fit.placing_px, "fits": fit.fits}
        words.append(f"display: {fit.words}")
        if patterns is not None:
            save_code(patterns, lit, places, fit, shape=shape, repeat=(repeat, repeat) if repeat else None)
            facts["files"] = [str(name) for name in files]
    if out is not None:
        save_coding(found, light, lit, noise, out)
    _show(facts, json)
    for line in () if json else words:
        report(line)


def _show(facts: dict[str, Any], json: bool) -> None:
    rows = []
    for key, limit in EQUAL.items():
        n = facts[f"equal_{key}"]
        gains = ["—" if math.isnan(g) else f"{g:+.3f}" for g in (n.rms_db, n.core_db, n.dark_db)]
        row = [f"equal {limit}", *gains, f"{100 * n.better:.0f} %", f"x {n.exposure:.3g}", f"{n.peak_e:.4g}"]
        rows.append([*row, *([f"{facts['measured_db'][key]:+.3f}"] if "measured_db" in facts else [])])
    headers = ["held equal", "all entries, rms (dB)", "bright (dB)", "dark (dB)", "entries better", "exposure"]
    headers += ["peak (e⁻)", *(["measured (dB)"] if "measured_db" in facts else [])]
    lit = f"{facts['frames']} frames of code {facts['code']}"
    title = f"{facts['points']} points of {facts['source']} lit by {lit}, compared with one point at a time"
    print_result(facts, headers, rows, title=title, json=json)


def _display(text: str) -> tuple[tuple[int, int], float]:
    """Return rows and columns of a display, and its pixel pitch (µm)."""
    size, _, pitch = text.partition("@")
    columns, _, rows = size.partition("x")
    try:
        pixel = float(pitch)
    except ValueError:
        pixel = math.nan
    if not (is_whole(columns) and is_whole(rows) and 0 < pixel < math.inf):
        raise InputError.expected(
            "display", "COLUMNSxROWS@PITCH in µm", repr(text)[:40], "write it in this form: 1920x1080@8"
        )
    return (int(rows), int(columns)), pixel


def _stored(source: Path, plane: int, mat_order: str) -> _Plane:
    with open_matrix(source, mat_order=mat_order) as matrix:
        if plane >= len(matrix):
            raise InputError.expected(
                "plane", f"0 … {len(matrix) - 1}", plane, f"choose one of the {len(matrix)} planes of {source}"
            )
        z = float(matrix.depths[plane])
        return _Plane(matrix[plane], z, matrix.camera, f"{source.name}, plane {plane}")


def _simulated(
    camera: Camera, virtual_depth: float | None, depth: float | None, first: tuple[int, int], points: int, step: int
) -> _Plane:
    """Return a plane of the described camera: only the requested positions are simulated, the others are dark."""
    import numpy as np

    from lfcal.camera import ScanPlan
    from lfcal.simulate import PlaneResponse, plan_effects

    if virtual_depth is not None and depth is not None:
        raise InputError.expected("plane", "one of --depth and --virtual-depth", "both", "leave one out")
    planes: dict[str, Any] = {"depths_um": (depth,)}
    if depth is None:
        planes = {"virtual_depths": (4.0 if virtual_depth is None else virtual_depth,)}
    plan = ScanPlan.for_camera(camera, **planes)
    effects = plan_effects(plan, TOLERANCE).effects
    response = PlaneResponse(plan, 0, effects, tolerance=TOLERANCE)
    ny, nx = plan.period
    side = step * np.arange(math.ceil(math.sqrt(points)))
    ys, xs = np.unique((first[0] + side) % ny), np.unique((first[1] + side) % nx)
    patterns = np.zeros((ny, nx, *plan.cutout), np.float32)
    patterns[ys[:, None], xs] = response.rows(ys, xs)
    return _Plane(patterns, plan.depths_um[0], camera, f"{camera.name} at {plan.depths_um[0]:.0f} µm, simulated")
