"""A simulated plane of a Raytrix R29, projected exactly and within tolerances: seconds, bytes and errors."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

from lfcal.base.checks import check_number
from lfcal.camera import ScanPlan, preset
from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors.device import ArrayDevice, find_device
from lfcal.simulate import simulate_psf

__all__ = ["WithinRow", "run_reduced", "show_reduced"]

CAMERA, VIRTUAL_DEPTH = "r29", 4.0
REPEATS = 3


@dataclass(frozen=True, slots=True)
class WithinRow:
    """A projection within a tolerance.

    Attributes
    ----------
    tolerance
        Requested tolerance; 0: exact.
    device
        Device that computes the projection.
    prepare_s, forward_s, adjoint_s
        Time of the fastest run (s).
    operand_bytes
        Memory of the prepared plane (bytes).
    error
        Relative L1 errors of an image and a back projection of random values.
    worst
        Largest relative L1 error of the images of some single points.
    """

    tolerance: float
    method: str
    prepare_s: float
    forward_s: float
    adjoint_s: float
    operand_bytes: int
    error: tuple[float, float]
    worst: float
    device: str = "cpu"


def run_reduced(
    side: int, tolerances: Sequence[float], workers: int, device: str | ArrayDevice = "auto"
) -> list[WithinRow]:
    """Return times and errors of the exact projection of a simulated plane and of those within ``tolerances``.

    They run in turns on the processor and on ``device``; ``auto`` uses an accelerator if it finds one.
    """
    for tolerance in tolerances:
        check_number("tolerance of the projection", tolerance, above=0, below=1)
    camera = preset(CAMERA)
    H = simulate_psf(ScanPlan.for_camera(camera, virtual_depths=[VIRTUAL_DEPTH]), workers=workers)[:]
    rng = np.random.default_rng(0)
    g, f = rng.random((1, side, side), np.float32), rng.random((side, side), np.float32)
    points = [tuple(place) for place in rng.integers(side // 4, 3 * side // 4, (6, 2)).tolist()]
    found = find_device(device) if isinstance(device, str) else device
    made = []
    for place in ("cpu", *(() if found is None else (found,))):
        for tolerance in (0.0, *tolerances):
            method = "reduced" if tolerance else "direct"
            start = time.perf_counter()
            P = Projector(H, (side, side), method=method, tolerance=tolerance, workers=workers, device=place).prepare()
            made.append((tolerance, P, time.perf_counter() - start))
    best = [[np.inf, np.inf] for _ in made]
    for _ in range(REPEATS):  # in turns, so that other load affects all of them equally
        for (_, P, _), least in zip(made, best, strict=True):
            for k, run in enumerate((lambda P=P: P.forward(g), lambda P=P: P.adjoint(f))):
                least[k] = min(least[k], _seconds(run))
    exact = made[0][1]
    truth = exact.forward(g), exact.adjoint(f)
    spots = [exact.forward(_point(side, place)) for place in points]
    rows = []
    for (tolerance, P, prepared), (ahead, back) in zip(made, best, strict=True):
        error = _l1(P.forward(g), truth[0]), _l1(P.adjoint(f), truth[1])
        worst = max(_l1(P.forward(_point(side, at)), spot) for at, spot in zip(points, spots, strict=True))
        name = "cpu" if P.device is None else P.device.name
        rows.append(WithinRow(tolerance, P.method, prepared, ahead, back, P.operand_bytes(), error, worst, name))
    return rows


def show_reduced(rows: Sequence[WithinRow], side: int) -> None:
    """Print the table, with speed-ups relative to the exact projection."""
    from lfcal.base.units import format_bytes
    from lfcal.base.units import format_seconds as seconds
    from lfcal.cli._console import print_table

    exact = rows[0]
    cells = [
        [
            f"{100 * row.tolerance:g} %" if row.tolerance else "exact",
            row.method,
            row.device,
            seconds(row.prepare_s),
            seconds(row.forward_s),
            seconds(row.adjoint_s),
            f"{exact.forward_s / row.forward_s:.1f}, {exact.adjoint_s / row.adjoint_s:.1f}",
            format_bytes(row.operand_bytes),
            " / ".join(f"{100 * e:.2g} %" for e in (*row.error, row.worst)),
        ]
        for row in rows
    ]
    headers = [
        "within",
        "method",
        "device",
        "set-up",
        "forward",
        "adjoint",
        "speed-up (forward, adjoint)",
        "bytes",
        "error: image, back, point",
    ]
    title = f"a plane of an R29 at v = {VIRTUAL_DEPTH:g}, 95 x 55 positions, image {side} x {side}"
    print_table(headers, cells, title=title)
    if all(row.device == "cpu" for row in rows):
        typer.echo("no accelerator took part: none was found that PyTorch or CuPy can use")


def _point(side: int, place: tuple[int, ...]) -> NDArray[np.float32]:
    volume = np.zeros((1, side, side), np.float32)
    volume[(0, *place)] = 1
    return volume


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _l1(found: NDArray[Any], truth: NDArray[Any]) -> float:
    return float(np.abs(found - truth).sum(dtype=float) / np.abs(truth).sum(dtype=float))
