"""``python -m benchmarks fourier``: projection of a Fourier light-field microscope compared with its FFTs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import typer

from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

IMAGE, CUTOUT, PLANES, REPEATS = 1200, 859, 9, 7
"""Side of the sensor and of the cutout of ``flfm_20x05`` over ± 40 µm (px), planes, and runs."""


def register(bench: typer.Typer) -> None:
    """Add ``fourier`` to the benchmarks."""
    bench.command("fourier")(command)


@dataclass(frozen=True, slots=True)
class Bound:
    """Processor time (s) of the projections, of an iteration and of the FFTs alone, each of the fastest run."""

    method: str
    transforms: int
    projection_s: float
    step_s: float
    fft_s: float
    ratio: float
    step_ratio: float
    error: float


def command(
    *,
    image: int = typer.Option(IMAGE, min=32, help="Side of the image (px)."),
    cutout: int = typer.Option(CUTOUT, min=3, help="Side of the cutout (px), odd."),
    planes: int = typer.Option(PLANES, min=1, help="Depth planes."),
    repeats: int = typer.Option(REPEATS, min=1, help="Runs of each, in turn; the fastest of each counts."),
    json: JsonOption = False,
) -> None:
    """Compare one forward and one back projection, and an iteration, with the FFTs that they require.

    The iteration is that of Richardson-Lucy. With n planes, n + 1 forward and n + 1 inverse transforms are required;
    those of H are made once. All runs use scipy.fft with one thread, and are measured in processor time. Other
    programs compete for caches and memory, which only lengthens the time. The fastest run of each therefore counts.

    Example: `python -m benchmarks fourier`
    """
    from lfcal.cli._console import print_json, print_table

    found = measure(image, cutout, planes, repeats)
    if json:
        print_json({"image": image, "cutout": cutout, "planes": planes, **asdict(found)})
        return
    rows = [
        [f"projection and back projection ({found.method})", f"{1e3 * found.projection_s:.1f} ms"],
        ["iteration of the solver rl", f"{1e3 * found.step_s:.1f} ms"],
        [f"{found.transforms} FFTs alone", f"{1e3 * found.fft_s:.1f} ms"],
        ["ratio of the projections", f"{found.ratio:.3f}"],
        ["ratio of the iteration", f"{found.step_ratio:.3f}"],
        ["largest error / peak", f"{found.error:.1e}"],
    ]
    title = f"image {image} x {image}, cutout {cutout} x {cutout}, {planes} planes, 1 thread"
    print_table(["", "processor time"], rows, title=title)


def measure(image: int, cutout: int, planes: int, repeats: int) -> Bound:
    """Return the times of all, in turn, for a random H and volume."""
    import numpy as np
    from scipy.fft import irfft2, next_fast_len, rfft2
    from scipy.signal import fftconvolve

    from lfcal.reconstruct import Projector, iter_richardson_lucy

    rng = np.random.default_rng(0)
    H = rng.random((planes, 1, 1, cutout, cutout), np.float32)
    volume, frame = rng.random((planes, image, image), np.float32), rng.random((image, image), np.float32)
    P = Projector(H, (image, image), method="auto", workers=1).prepare()
    side = next_fast_len(image + (cutout - 1) // 2, real=True)
    shape, spectra = (side, side), [rfft2(one, (side, side), workers=1) for one in volume]

    def projected() -> NDArray[np.float32]:
        P.adjoint(frame)
        return P.forward(volume)

    def bare() -> None:
        for one in volume:
            rfft2(one, shape, workers=1)
        irfft2(spectra[0], shape, workers=1)
        rfft2(frame, shape, workers=1)
        for spectrum in spectra:
            irfft2(spectrum, shape, workers=1)

    truth = sum(fftconvolve(g, h[0, 0].astype(float), mode="same") for g, h in zip(volume, H, strict=True))
    error = float(np.abs(projected() - truth).max() / np.abs(truth).max())
    steps = iter_richardson_lucy(P, frame, repeats + 1)
    runs = (projected, lambda: next(steps), bare)
    times = [[_seconds(run) for run in runs] for _ in range(repeats + 1)][1:]
    ours, step, ffts = (min(one) for one in zip(*times, strict=True))
    return Bound(P.method, 2 * planes + 2, ours, step, ffts, ours / ffts, step / ffts, error)


def _seconds(run: Callable[[], object]) -> float:
    start = time.process_time()
    run()
    return time.process_time() - start
