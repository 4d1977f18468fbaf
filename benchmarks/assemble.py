"""``python -m benchmarks assemble``: assembly compared with decoding alone, and the memory of a file transpose."""

from __future__ import annotations

import statistics
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import typer

from lfcal.cli._options import JsonOption


def register(app: typer.Typer) -> None:
    """Add ``assemble`` and ``transpose-file`` to the benchmarks."""
    app.command("assemble")(assemble_command)
    app.command("transpose-file")(transpose_command)


def assemble_command(
    *,
    rows: int = typer.Option(19, help="Rows of positions."),
    columns: int = typer.Option(55, help="Columns of positions."),
    size: int = typer.Option(512, help="Side of a frame (px)."),
    cutout: int = typer.Option(181, help="Side of the cutout (px)."),
    repeats: int = typer.Option(3, help="Repetitions; medians are printed."),
    json: JsonOption = False,
) -> None:
    """Compare the time of assembling H from 16-bit PNG files with the time of decoding them.

    Example: `python -m benchmarks assemble`
    """
    from lfcal.base.units import format_seconds
    from lfcal.cli._console import print_json, print_table

    with TemporaryDirectory() as name:
        folder = Path(name)
        _write_session(folder, rows, columns, size, cutout)
        decode, whole = [], []
        # the first round compiles kernels and fills the disk cache, so it does not count
        for _ in range(repeats + 1):
            decode.append(_decode(folder))
            whole.append(_assemble(folder, rows, columns, cutout))
    a, b = statistics.median(decode[1:]), statistics.median(whole[1:])
    found = {"frames": rows * columns, "decode_s": a, "assemble_s": b, "overhead": b / a - 1}
    if json:
        print_json(found)
        return
    title = f"{rows * columns} frames of {size} x {size} px, 16-bit PNG, cutout {cutout} x {cutout}, dark subtracted"
    print_table(
        ["", "time", "÷ decoding"],
        [
            ["decoding alone, same threads", format_seconds(a), "1"],
            ["frames to H file", format_seconds(b), f"{b / a:.2f}"],
        ],
        title=title,
    )


def _write_session(folder: Path, rows: int, columns: int, size: int, cutout: int) -> None:
    import cv2

    rng = np.random.default_rng(0)
    (folder / "frames").mkdir()
    noise = rng.normal(100, 3, (size, size))
    lines = ["file,z,y,x"]
    r, c = np.mgrid[-(cutout // 2) : cutout // 2 + 1, -(cutout // 2) : cutout // 2 + 1]
    spots = 3000 * np.exp(-(r**2 + c**2) / (cutout / 4) ** 2) * (np.cos(r / 4) * np.cos(c / 4)) ** 4
    top, left = (size - cutout - rows) // 2, (size - cutout - columns) // 2
    for y in range(rows):
        for x in range(columns):
            # shifted instead of drawn again: fast, and no two frames are equal
            frame = np.roll(noise, (7 * y, 5 * x), (0, 1))
            frame[top + y : top + y + cutout, left + x : left + x + cutout] += spots
            cv2.imwrite(str(folder / "frames" / f"y{y}_x{x}.png"), np.rint(frame).astype(np.uint16))
            lines.append(f"y{y}_x{x}.png,0,{y},{x}")
    (folder / "frames" / "manifest.csv").write_text("\n".join(lines) + "\n")
    np.save(folder / "dark.npy", np.full((size, size), 100, np.uint16))


def _decode(folder: Path) -> float:
    import cv2

    from lfcal.base.threads import worker_count

    files = sorted(str(p) for p in (folder / "frames").glob("*.png"))

    def first_pixel(name: str) -> int:
        frame = cv2.imread(name, cv2.IMREAD_UNCHANGED)
        return -1 if frame is None else int(frame[0, 0])

    start = time.perf_counter()
    with ThreadPoolExecutor(worker_count()) as pool:
        pixels = list(pool.map(first_pixel, files))
    if min(pixels) < 0:
        raise RuntimeError("a benchmark frame could not be decoded")
    return time.perf_counter() - start


def _assemble(folder: Path, rows: int, columns: int, cutout: int) -> float:
    from lfcal.frames import CorrectionChain, Dark, corrected, open_frames
    from lfcal.psf import Cutout, assemble

    start = time.perf_counter()
    with open_frames(folder / "frames", plan_shape=(1, rows, columns)) as source:
        size = source.shape[0]
        anchor = ((size - cutout - rows) // 2 + cutout // 2, (size - cutout - columns) // 2 + cutout // 2)
        chain = CorrectionChain((Dark(np.load(folder / "dark.npy")),))
        out = folder / "H.h5"
        report = assemble(
            corrected(source, chain), (1, rows, columns), Cutout((cutout, cutout), anchor), out, dtype="rounded"
        )
        report.matrix.close()
    return time.perf_counter() - start


def transpose_command(
    *,
    gigabytes: float = typer.Option(2.0, help="Size of H (GB)."),
    planes: int = typer.Option(11, help="Depth planes."),
    json: JsonOption = False,
) -> None:
    """Transpose an H file to an HT file in a separate process, and measure its time and peak memory.

    Example: `python -m benchmarks transpose-file`
    """
    from lfcal.base.units import format_bytes, format_seconds
    from lfcal.cli._console import print_json, print_table

    with TemporaryDirectory() as name:
        found = _transpose_file(Path(name), gigabytes, planes)
    if json:
        print_json(found)
        return
    rows = [
        ["H", format_bytes(found["bytes"])],
        ["one plane", format_bytes(found["plane_bytes"])],
        ["time", format_seconds(found["seconds"])],
        ["peak memory", format_bytes(found["peak_bytes"])],
    ]
    print_table(["file to file", ""], rows)


def _transpose_file(folder: Path, gigabytes: float, planes: int) -> dict[str, Any]:
    import subprocess
    import sys

    from lfcal.base.system import peak_memory
    from lfcal.psf import PSFWriter

    nt, ny, nx = 101, 19, 33
    nx = max(1, round(gigabytes * 1e9 / (4 * planes * ny * nt * nt)))
    shape = (planes, ny, nx, nt, nt)
    rng = np.random.default_rng(0)
    # 70 % zeros, as between micro-images, because they determine the cost of compression
    row = rng.random((nx, nt, nt), np.float32) * (rng.random((nx, nt, nt), np.float32) > 0.7)
    with PSFWriter(folder / "H.h5", shape) as writer:
        for z in range(planes):
            writer.write_plane(z, np.broadcast_to(row, shape[1:]))
    start = time.perf_counter()
    subprocess.run(
        [
            sys.executable,
            "-c",
            "from lfcal.cli import main; main()",
            "transpose",
            str(folder / "H.h5"),
            "-o",
            str(folder / "HT.h5"),
        ],
        check=True,
        capture_output=True,
    )
    seconds = time.perf_counter() - start
    plane = 4 * ny * nx * nt * nt
    return {"bytes": plane * planes, "plane_bytes": plane, "seconds": seconds, "peak_bytes": peak_memory(children=True)}
