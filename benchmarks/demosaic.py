"""``python -m benchmarks demosaic``: error and time of demosaicing filters of several programs on photographs."""

from __future__ import annotations

import importlib
import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption
from lfcal.multiplex import Modulator, cfa, demultiplex, multiplex
from lfcal.multiplex.filters import COLOUR_FILTERS, LINEAR_FILTERS, SPATIAL_FILTERS

__all__ = ["SHIPPED", "Row", "mean_psnr", "measure", "register"]

Image = NDArray[Any]
Way = Callable[[Image], Image]

SHIPPED = (
    ("skimage", "data/astronaut.png"),
    ("skimage", "data/chelsea.png"),
    ("skimage", "data/coffee.png"),
    ("skimage", "data/rocket.jpg"),
    ("sklearn", "datasets/images/china.jpg"),
    ("sklearn", "datasets/images/flower.jpg"),
    ("matplotlib", "mpl-data/sample_data/grace_hopper.jpg"),
)
"""Public photographs, with the package that contains them."""

BORDER_PX = 8


@dataclass(frozen=True, slots=True)
class Row:
    """One demosaicing method.

    Attributes
    ----------
    name
        Program and filter.
    psnr_db
        Mean PSNR over the photographs, without borders, for values up to 255 (dB).
    worst_db
        Lowest PSNR of a photograph (dB).
    seconds_per_megapixel
        Time of the fastest round over all photographs.
    """

    name: str
    psnr_db: float
    worst_db: float
    seconds_per_megapixel: float


def register(bench: typer.Typer) -> None:
    """Add ``demosaic`` to the benchmarks."""
    bench.command("demosaic")(command)


def command(
    images: list[Path] | None = typer.Argument(
        None, help="Colour photographs; default: those in scikit-image, scikit-learn and matplotlib."
    ),
    *,
    pattern: str = typer.Option(
        "GRBG", help="Colour filter pattern; other programs are compared only for Bayer patterns."
    ),
    rounds: int = typer.Option(3, min=1, help="Runs of each method; the fastest counts."),
    workers: int | None = typer.Option(
        None, min=1, help="Number of threads, including those of OpenCV; default: every processor."
    ),
    json: JsonOption = False,
) -> None:
    """Compare error and time of demosaicing methods on photographs at half size.

    Example: `python -m benchmarks demosaic --pattern X-Trans`
    """
    files = list(images or _shipped())
    modulator = cfa(pattern)
    rows = measure([halved(file) for file in files], modulator, pattern.upper(), workers, rounds)
    if json:
        print_json(
            {"images": [file.name for file in files], "pattern": modulator.name, "rows": [asdict(row) for row in rows]}
        )
        return
    table = [[r.name, f"{r.psnr_db:.2f}", f"{r.worst_db:.2f}", f"{1e3 * r.seconds_per_megapixel:.0f}"] for r in rows]
    title = f"{modulator.name}, {len(files)} photographs at half size: {', '.join(file.stem for file in files)}"
    print_table(["method", "mean PSNR (dB)", "worst (dB)", "time (ms per megapixel)"], table, title=title)


def _shipped() -> Iterator[Path]:
    for package, name in SHIPPED:
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.origin is not None and (Path(spec.origin).parent / name).exists():
            yield Path(spec.origin).parent / name


def halved(file: Path) -> Image:
    """Return a photograph ``(3, rows, columns)`` with values 0 to 255 at half size, without demosaicing artefacts."""
    import cv2

    image = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if image is None or min(image.shape[:2]) < 8 * BORDER_PX:
        got = "none" if image is None else f"{image.shape[1]} x {image.shape[0]} px"
        raise InputError.expected(
            str(file), f"a colour image of {8 * BORDER_PX} px or more", got, "choose another file"
        )
    rows, columns = (n // 4 * 2 for n in image.shape[:2])
    pairs = image[: 2 * rows, : 2 * columns, ::-1].reshape(rows, 2, columns, 2, 3)
    return np.ascontiguousarray(pairs.mean((1, 3), dtype=np.float32).transpose(2, 0, 1))


def measure(
    photographs: list[Image], modulator: Modulator, pattern: str, workers: int | None, rounds: int
) -> list[Row]:
    """Return error and time of each method for the pattern, best first."""
    frames = [multiplex(image, modulator).astype(np.float32) for image in photographs]
    megapixels = sum(frame.size for frame in frames) / 1e6
    rows = []
    for name, way in (_ours(modulator, workers) | _opencv(pattern, workers) | _colour_demosaicing(pattern)).items():
        found = [way(frame) for frame in frames]  # the first ones compile
        quality = [_psnr(f, image) for f, image in zip(found, photographs, strict=True)]
        seconds = min(_seconds(way, frames) for _ in range(rounds))
        rows.append(Row(name, float(np.mean(quality)), min(quality), seconds / megapixels))
    return sorted(rows, key=lambda row: -row.psnr_db)


def mean_psnr(filter: str, pattern: str = "GRBG", workers: int | None = None) -> float:
    """Return the mean PSNR (dB) of a filter of lfcal over the installed photographs of `SHIPPED`."""
    photographs = [halved(file) for file in _shipped()]
    modulator = cfa(pattern)
    found = [
        demultiplex(multiplex(image, modulator), modulator, filter=filter, workers=workers) for image in photographs
    ]
    return float(np.mean([_psnr(f, image) for f, image in zip(found, photographs, strict=True)]))


def _seconds(way: Way, frames: list[Image]) -> float:
    start = time.perf_counter()
    for frame in frames:
        way(frame)
    return time.perf_counter() - start


def _psnr(found: Image, truth: Image) -> float:
    inner = slice(BORDER_PX, -BORDER_PX)
    error = (np.clip(found, 0, 255) - truth)[:, inner, inner]
    return float(10 * np.log10(255**2 / max(float(np.mean(error**2, dtype=float)), 1e-12)))


def _ours(modulator: Modulator, workers: int | None) -> dict[str, Way]:
    # without the slow periodic sinc, whose result equals that of the Fourier route
    names = [name for name in (*SPATIAL_FILTERS, *COLOUR_FILTERS) if name != LINEAR_FILTERS[-1]]
    ways: dict[str, Way] = {
        f"lfcal {name}": lambda frame, name=name: demultiplex(frame, modulator, filter=name, workers=workers)  # type: ignore[misc]
        for name in names
    }
    return ways | {
        "lfcal Fourier": lambda frame: demultiplex(frame, modulator, route="fourier", samples=modulator.side)
    }


def _opencv(pattern: str, workers: int | None) -> dict[str, Way]:
    import cv2

    if workers is not None:
        cv2.setNumThreads(workers)
    ways: dict[str, Way] = {}
    for name, end in (("bilinear", ""), ("edge-aware", "_EA"), ("VNG", "_VNG")):
        code = getattr(cv2, f"COLOR_Bayer{pattern}2RGB{end}", None)
        if code is not None:
            ways[f"OpenCV {name}"] = lambda frame, code=code: cv2.demosaicing(  # type: ignore[misc]
                np.rint(frame).astype(np.uint8), code
            ).transpose(2, 0, 1)
    return ways


def _colour_demosaicing(pattern: str) -> dict[str, Way]:
    """Return the methods of colour-demosaicing, if it is installed."""
    if pattern not in ("RGGB", "BGGR", "GRBG", "GBRG") or importlib.util.find_spec("colour_demosaicing") is None:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings about its optional packages
        library: Any = importlib.import_module("colour_demosaicing")
    found = {
        "Malvar 2004": library.demosaicing_CFA_Bayer_Malvar2004,
        "Menon 2007": library.demosaicing_CFA_Bayer_Menon2007,
    }
    return {
        f"colour-demosaicing {name}": lambda frame, way=way: np.asarray(way(frame, pattern)).transpose(2, 0, 1)  # type: ignore[misc]
        for name, way in found.items()
    }
