"""``lfcal multiplex coding``: whether lighting several points at once pays for a camera, and the code for a display."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from lfcal.base import InputError, check_choice
from lfcal.cli._console import print_json, print_table, report
from lfcal.cli._options import ForceOption, GainOption, JsonOption, MatOrderOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import CODES, is_whole
from lfcal.tasks import check_mat_files, check_output, check_outputs, open_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.camera import Camera
    from lfcal.multiplex import CodingNumbers, CodingVerdict, DisplayFit

__all__ = ["coding"]

MATRICES = (".h5", ".hdf5", ".mat", ".npy", ".lfc")


TOLERANCE = 0.03
"""Of the simulated patterns: gains change by far less."""


class _Plane(NamedTuple):
    """A plane of patterns ``(ny, nx, nt, ns)``, its depth (µm), its camera where known, and what it is."""

    patterns: Any
    depth_um: float
    camera: Camera | None
    words: str


class _Display(NamedTuple):
    rows: int
    columns: int
    pixel_um: float


def coding(
    context: typer.Context,
    source: str = typer.Argument(help="H file; or preset or camera file, whose patterns are simulated."),
    *,
    points: int = typer.Option(7, min=2, max=255, help="Points whose patterns overlap, in a block."),
    step: int = typer.Option(1, min=1, help="Source positions from point to point (px in the image)."),
    at: str = typer.Option("0,0", help="Y,X: position of the first point."),
    plane: int = typer.Option(0, min=0, help="Plane of the H file."),
    virtual_depth: float | None = typer.Option(
        None, help="Of a camera: virtual depth of the simulated plane, 4 by default."
    ),
    depth: float | None = typer.Option(None, help="Of a camera: the plane's depth (µm) instead."),
    code: str = typer.Option("S", help="S (S-matrix), random, or single."),
    frames: int | None = typer.Option(None, min=1, help="Of random codes; as many as points by default."),
    density: float = typer.Option(0.5, help="Of random codes: share of points that are lit."),
    seed: int = typer.Option(0, min=0, help="Of random codes and --monte-carlo."),
    signal: float | None = typer.Option(
        None, help="Electrons of a point's brightest pixel in a frame; full well by default."
    ),
    sensor: str | None = typer.Option(None, help="Preset or camera file whose sensor is taken; by default SOURCE's."),
    gain: GainOption = 1.0,
    exposure: float = typer.Option(0.0, min=0, help="Seconds in which dark current gathers."),
    uncorrected: bool = typer.Option(False, "--uncorrected", help="Frames are not divided by a white image."),
    monte_carlo: int = typer.Option(0, min=0, help="Also measure the gain on this many simulated series of frames."),
    display: str | None = typer.Option(
        None, help="Is this display good enough: COLUMNSxROWS@PITCH in µm, e.g. 1920x1080@8."
    ),
    patterns: Path | None = typer.Option(
        None, help="With --display: folder for its frames, code_000.png … and code.npy."
    ),
    repeat: int = typer.Option(0, min=0, help="With --patterns: show the block again after so many px in the image."),
    out: Path | None = typer.Option(None, "--out", "-o", help="Draw the gain of each entry, and over light, as PNG."),
    mat_order: MatOrderOption = "",
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Say whether lighting several points at once pays: gain of each entry of H at equal time and equal full well.

    Example: `lfcal multiplex coding H.h5 --points 7 --signal 300 --display 1920x1080@8 --patterns code -o gain.png`
    """
    import numpy as np

    from lfcal.multiplex import (
        code_matrix,
        coding_pays,
        display_fit,
        measured_coding_gain,
        overlapping_patterns,
        save_coding,
    )

    check_choice("code", code, CODES)
    if out is not None:
        check_output(out, source, sensor, force=force)
    check_mat_files(mat_order, Path(source))
    if code != "random":
        refuse(context, "--code random", f"--code {code}", "density", *(() if monte_carlo else ("seed",)))
    if patterns is None:
        refuse(context, "--patterns", "none", "repeat")
    screen = _display(display)
    rng = np.random.default_rng(seed)
    lit = code_matrix(code, points, frames=frames, density=density, rng=rng)
    names = _files(patterns, len(lit), screen)
    check_outputs(names, source, sensor, force=force)
    seen = _plane(source, plane, virtual_depth, depth, _pair(at), points=points, step=step, mat_order=mat_order)
    noise = _noise(sensor, seen.camera, gain, exposure, corrected=not uncorrected)
    light, places = overlapping_patterns(seen.patterns, points, step=step, first=_pair(at))
    verdicts = [coding_pays(light, noise, code=lit, signal_e=signal, limit=limit) for limit in ("time", "full well")]
    found = verdicts[0].gain
    told: dict[str, Any] = {
        "source": seen.words,
        "code": code,
        "points": points,
        "frames": len(lit),
        "signal_e": found.signal_e,
        "full_e": noise.full_e,
        "additive_e2": noise.additive_e2,
        "pays": {v.limit.replace(" ", "_"): v.pays for v in verdicts},
        "equal_time": found.time,
        "equal_full_well": found.full_well,
        "break_even_e": verdicts[0].break_even_e if math.isfinite(verdicts[0].break_even_e) else None,
        "pays_at_any_light": math.isinf(verdicts[0].break_even_e),
    }
    if monte_carlo:
        options: dict[str, Any] = {"signal_e": found.signal_e, "trials": monte_carlo, "rng": rng}
        told["measured_db"] = {
            v.limit.replace(" ", "_"): measured_coding_gain(light, lit, noise, limit=v.limit, **options)
            for v in verdicts
        }
    fit = None if screen is None else display_fit(_step_um(seen), screen.pixel_um)
    if fit is not None:
        told["display"] = {"pixel_um": fit.pixel_um, "needed_um": fit.step_um, "image_px": fit.image_px}
        told["display"] |= {"placing_px": fit.placing_px, "fits": fit.fits}
    if screen is not None and fit is not None and patterns is not None:
        _write(names, lit, places, fit, screen, repeat)
        told["files"] = [str(name) for name in names]
    if out is not None:
        save_coding(found, light, lit, noise, out)
    if json:
        print_json(told)
        return
    _show(told, verdicts, fit)


def _show(told: dict[str, Any], verdicts: list[CodingVerdict], fit: DisplayFit | None) -> None:
    rows = [_row("equal time", told["equal_time"]), _row("equal full well", told["equal_full_well"])]
    headers = [
        "held equal",
        "all entries, rms (dB)",
        "bright (dB)",
        "dark (dB)",
        "entries better",
        "exposure",
        "peak (e⁻)",
    ]
    lit = f"{told['frames']} frames of code {told['code']}"
    title = f"{told['points']} points of {told['source']} lit by {lit}, over one at a time"
    if "measured_db" in told:
        headers.append("measured (dB)")
        for row, value in zip(rows, told["measured_db"].values(), strict=True):
            row.append(f"{value:+.3f}")
    print_table(headers, rows, title=title)
    for verdict in verdicts:
        report(verdict.words)
    if fit is not None:
        report(f"display: {fit.words}")


def _row(name: str, n: CodingNumbers) -> list[str]:
    gains = ["—" if math.isnan(g) else f"{g:+.3f}" for g in (n.rms_db, n.core_db, n.dark_db)]
    return [name, *gains, f"{100 * n.better:.0f} %", f"x {n.exposure:.3g}", f"{n.peak_e:.4g}"]


def _pair(text: str) -> tuple[int, int]:
    parts = text.split(",")
    if len(parts) != 2 or not all(is_whole(part.strip()) for part in parts):
        raise InputError.expected("position of the first point", "Y,X", repr(text)[:40], "give two whole numbers: 0,0")
    return int(parts[0]), int(parts[1])


def _display(text: str | None) -> _Display | None:
    if text is None:
        return None
    size, _, pitch = text.partition("@")
    columns, _, rows = size.partition("x")
    try:
        pixel = float(pitch)
    except ValueError:
        pixel = math.nan
    if not (is_whole(columns) and is_whole(rows) and 0 < pixel < math.inf):
        raise InputError.expected("display", "COLUMNSxROWS@PITCH in µm", repr(text)[:40], "such as 1920x1080@8")
    return _Display(int(rows), int(columns), pixel)


def _files(folder: Path | None, frames: int, screen: _Display | None) -> list[Path]:
    if folder is None:
        return []
    if screen is None:
        raise InputError.expected("display", "one for --patterns", "none", "give --display, e.g. 1920x1080@8")
    return [*(folder / f"code_{k:03d}.png" for k in range(frames)), folder / "code.npy"]


def _plane(
    source: str,
    plane: int,
    virtual_depth: float | None,
    depth: float | None,
    first: tuple[int, int],
    *,
    points: int,
    step: int,
    mat_order: str = "",
) -> _Plane:
    if Path(source).suffix.lower() not in MATRICES:
        from lfcal.tasks import load_camera

        if plane:
            raise InputError.expected("--plane", "an H file", source, "name the plane with --depth or --virtual-depth")
        return _simulated(load_camera(source), virtual_depth, depth, first, points, step)
    if virtual_depth is not None or depth is not None:
        raise InputError("--depth, --virtual-depth: are of a simulated plane; take --plane of an H file")
    with open_matrix(Path(source), mat_order=mat_order) as matrix:
        if plane >= len(matrix):
            raise InputError.expected("plane", f"0 … {len(matrix) - 1}", plane, f"{source} has {len(matrix)}")
        z = float(matrix.depths[plane])
        return _Plane(matrix[plane], z, matrix.camera, f"{Path(source).name}, plane {plane}")


def _simulated(
    camera: Camera, virtual_depth: float | None, depth: float | None, first: tuple[int, int], points: int, step: int
) -> _Plane:
    """Return a plane of the described camera: the positions that are looked at are simulated, the others dark."""
    import numpy as np

    from lfcal.camera import ScanPlan
    from lfcal.simulate import PlaneResponse, plan_effects

    if virtual_depth is not None and depth is not None:
        raise InputError.expected("plane", "one of --depth and --virtual-depth", "both", "leave one out")
    planes: dict[str, Any] = (
        {"depths_um": (depth,)}
        if depth is not None
        else {"virtual_depths": (4.0 if virtual_depth is None else virtual_depth,)}
    )
    plan = ScanPlan.for_camera(camera, **planes)
    effects = plan_effects(plan, TOLERANCE).effects
    response = PlaneResponse(plan, 0, effects, tolerance=TOLERANCE)
    ny, nx = plan.period
    side = step * np.arange(math.ceil(math.sqrt(points)))
    ys, xs = np.unique((first[0] + side) % ny), np.unique((first[1] + side) % nx)
    patterns = np.zeros((ny, nx, *plan.cutout), np.float32)
    patterns[ys[:, None], xs] = response.rows(ys, xs)
    return _Plane(patterns, plan.depths_um[0], camera, f"{camera.name} at {plan.depths_um[0]:.0f} µm, simulated")


def _noise(sensor: str | None, camera: Camera | None, gain: float, exposure: float, *, corrected: bool) -> Any:
    from lfcal.multiplex import sensor_noise
    from lfcal.tasks import load_camera

    described = camera if sensor is None else load_camera(sensor)
    if described is None:
        raise InputError.expected("sensor", "one", "none: this H file names no camera", "give --sensor")
    return sensor_noise(described.sensor, gain=gain, exposure_s=exposure, flat_corrected=corrected)


def _step_um(seen: _Plane) -> float:
    if seen.camera is None:
        raise InputError.expected(
            "camera", "one for --display", "none: this H file names no camera", "give another file"
        )
    return seen.camera.step_um(seen.depth_um)


def _write(
    files: list[Path], code: NDArray[Any], places: NDArray[Any], fit: DisplayFit, screen: _Display, repeat: int
) -> None:
    """Write what the display shows, frame by frame, and the code ``(frames, points)``."""
    import cv2
    import numpy as np

    from lfcal.base import npy_header, replace_whole, storage_errors
    from lfcal.multiplex import display_frames

    files[0].parent.mkdir(parents=True, exist_ok=True)
    again = (repeat, repeat) if repeat else None
    shown = display_frames(code, places, fit, (screen.rows, screen.columns), repeat=again)
    for path, image in zip(files, shown, strict=False):
        with storage_errors(path), replace_whole(path) as part:
            part.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    values = np.ascontiguousarray(code, "<f8")
    with storage_errors(files[-1]), replace_whole(files[-1]) as part:
        part.write_bytes(npy_header(values.shape, values.dtype) + values.tobytes())
