"""``python -m benchmarks debye``: simulation of a microscope compared with pyolaf, for one plane and cutout."""

from __future__ import annotations

import contextlib
import importlib
import io
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.base.units import format_seconds
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption

__all__ = ["Row", "measure", "register"]

NODES = (1, 2, 3, 4)
REFERENCE_SAMPLES = 6
POSITIONS = ((0, 0), (4, 2), (7, 7))


@dataclass(frozen=True, slots=True)
class Row:
    """One computation of all positions of a plane.

    Attributes
    ----------
    name
        Code and sampling.
    seconds
        Processor time of the fastest run (s).
    error
        Mean L1 error relative to the converged reference, with each response scaled to the same light.
    positions
        Number of computed positions.
    """

    name: str
    seconds: float
    error: float
    positions: int


def register(bench: typer.Typer) -> None:
    """Add ``debye`` to the benchmarks."""
    bench.command("debye")(command)


def command(
    *,
    depth: float = typer.Option(25.0, help="Depth of the plane in µm, positive away from the objective."),
    cutout: int = typer.Option(151, help="Side of the cutout (px), odd."),
    repeat: int = typer.Option(3, min=1, help="Runs of each; the fastest counts."),
    json: JsonOption = False,
) -> None:
    """Time the simulation of a plane of the 20x/0.5 microscope, by lfcal and by pyolaf 0.2.1 if it is installed.

    Example: `python -m benchmarks debye --depth 25 --cutout 151`
    """
    rows = measure(depth, cutout, repeat)
    if json:
        print_json([asdict(row) for row in rows])
    else:
        _show(rows, f"lfm_20x05, z = {depth:g} µm, {cutout} x {cutout} px")


def _show(rows: list[Row], title: str) -> None:
    theirs = next((row for row in rows if row.name.startswith("pyolaf")), None)
    table = [
        [
            r.name,
            format_seconds(r.seconds),
            f"{100 * r.error:.2g} %",
            str(r.positions),
            f"{theirs.seconds / r.seconds:.3g}" if theirs else "—",
        ]
        for r in rows
    ]
    headers = ["code", "processor time", "L1 error", "positions", "pyolaf ÷ this"]
    print_table(headers, table, title=title)
    if theirs is None:
        typer.echo("pyolaf is not installed: pip install pyolaf==0.2.1 to compare")


def measure(depth_um: float, cutout: int, repeat: int) -> list[Row]:
    """Return the times and errors of one plane; the last row is that of pyolaf, if it is installed."""
    from lfcal.camera import preset
    from lfcal.simulate.engines.base import Sampling
    from lfcal.simulate.engines.microscope import DebyePlane
    from lfcal.simulate.engines.reference import ReferencePlane
    from lfcal.simulate.staging import scene_of

    if cutout % 2 == 0 or cutout < 31:
        raise InputError.expected("cutout", "an odd number of at least 31", cutout, "choose another")
    scene = scene_of(preset("lfm_20x05"), z_um=depth_um, cutout=(cutout, cutout))
    judge = ReferencePlane(scene, Sampling(REFERENCE_SAMPLES))
    wanted = [judge.rows([y], [x])[0, 0] for y, x in POSITIONS]
    rows = []
    for nodes in NODES:
        DebyePlane(scene, Sampling(nodes_per_px=nodes)).rows([0], [0], workers=1)  # compiled before the clock starts

        def plane(n: int = nodes) -> NDArray[np.float32]:
            return DebyePlane(scene, Sampling(nodes_per_px=n)).rows(range(15), range(15), workers=1)

        seconds, found = _best(plane, repeat)
        error = _error([found[y, x] for y, x in POSITIONS], wanted)
        rows.append(Row(f"lfcal, {nodes} nodes per pixel", seconds, error, 225))
    theirs = _pyolaf()
    if theirs is not None:
        seconds, responses = _best(lambda: _pyolaf_plane(theirs, depth_um, cutout), repeat)
        # entry (i, j) of pyolaf is the source at (i, j) - 7 from the lenslet; it computes a quarter of them
        found_there = [np.asarray(responses[7 - y, 7 - x, 0].toarray())[::-1, ::-1] for y, x in POSITIONS]
        rows.append(Row("pyolaf 0.2.1, 1 sample per pixel", seconds, _error(found_there, wanted), 64))
    return rows


def _best(run: Callable[[], Any], repeat: int) -> tuple[float, Any]:
    best, result = math.inf, None
    for _ in range(repeat):
        start = time.process_time()
        result = run()
        best = min(best, time.process_time() - start)
    return best, result


def _error(found: list[NDArray[Any]], wanted: list[NDArray[np.float32]]) -> float:
    errors = [np.abs(f / f.sum() - w / w.sum()).sum() for f, w in zip(found, wanted, strict=True)]
    return float(np.mean(errors))


def _pyolaf() -> Any:
    try:
        return importlib.import_module("pyolaf.lf")
    except ImportError:
        return None


def _pyolaf_plane(lf: Any, depth_um: float, cutout: int) -> Any:
    """Return the forward patterns of one plane of the preset, as the driver of pyolaf computes them."""
    pitch, focal, pixels = 125.0, 2500.0, 15
    pixel, k = pitch / pixels, 2 * math.pi / 0.525
    camera = {
        "n": 1.0,
        "WaveLength": 0.525,
        "NA": 0.5,
        "M": 20,
        "dof": 10e3,
        "k": k,
        "fm": focal,
        "lensPitch": pitch,
        "range": "quarter",
        "mla2sensor": focal,
        "offsetFobj": 0.0,
    }
    half = cutout // 2
    line, lens = pixel * np.arange(-half, half + 1), pixel * np.arange(-(pixels // 2), pixels // 2 + 1)
    reach = half // pixels + 2
    centres = np.stack(np.meshgrid(*[pixels * np.arange(-reach, reach + 1)] * 2, indexing="ij"), -1)
    resolution = {
        "depths": np.array([-depth_um]),
        "yspace": line,
        "xspace": line,
        "yMLspace": lens,
        "xMLspace": lens,
        "maskFlag": 1,
        "sensMask": np.ones((pixels, pixels)),
        "usedLensletCenters": {"px": centres},
        "TexNnum_half": np.array([8, 8]),
        "TexNnum": np.array([pixels, pixels]),
        "texScaleFactor": np.array([1.0, 1.0]),
        "sensorRes": np.array([pixel, pixel]),
    }
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        field = lf.LFM_calcPSFAllDepths(camera, resolution)
        array = lf.LFM_mlaTransmittance(camera, resolution, lf.LFM_ulensTransmittance(camera, resolution))
        return lf.LFM_computeForwardPatternsWaves(field, array, camera, resolution)
