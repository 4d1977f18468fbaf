"""A reconstruction in the window: light field, forecast, and a run that can be stopped and continued. No Qt."""

from __future__ import annotations

import csv
import math
import threading
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work, format_bytes, format_seconds, map_npy, read_text
from lfcal.base.h5 import H5File
from lfcal.psf import PSFMatrix, mat_order_of
from lfcal.reconstruct import (
    DATASET,
    Resampling,
    SolverChoice,
    SolverProgress,
    SolverState,
    VolumeFacts,
    bar_outputs,
    cleaner,
    cropped,
    drift_note,
    drift_words,
    load_volume,
    nrmse,
    volume_facts,
)
from lfcal.reconstruct.solvers import iter_solve
from lfcal_gui.pages.reconstruct.model import BARS, ReconstructSettings

VOLUMES_ALONE = (".h5", ".hdf5")
"""Suffixes of volumes that no image has."""

# -- light field ----------------------------------------------------------------------------------------
LARGEST = 640
COUNTS = 2000.0


def light_field(path: str) -> NDArray[Any]:
    """Return the light field in an image file, ``(rows, columns)``."""
    from lfcal.frames import read_image

    return read_image(Path(path))


class OpenedVolume(NamedTuple):
    """A volume ``(nz, Y, X)`` from the file or folder ``path``, and the facts stated there.

    ``maps`` describe the uncertainty of the volume, by name (`bar_outputs`). ``regions`` are the rows of the table of
    regions.
    """

    path: str
    values: NDArray[np.float32]
    facts: VolumeFacts
    maps: Mapping[str, NDArray[np.float32]] = {}
    regions: tuple[Mapping[str, str], ...] = ()


def opened(path: str) -> NDArray[Any] | OpenedVolume | None:
    """Return the light field or the volume at ``path``. None: an H, which another page shows.

    Files with several planes contain volumes.
    """
    planes = _planes_in(Path(path))
    if planes is None:
        return None
    return read_volume(path) if planes > 1 else light_field(path)


def read_volume(path: str) -> OpenedVolume:
    """Return the volume in a file or folder, with the maps and the table of its error bars if they are next to it."""
    values, facts = load_volume(path), volume_facts(path)
    _, sigma, kappa, _, table = bar_outputs(Path(path), regions=True)
    if not (sigma.exists() and kappa.exists()):
        return OpenedVolume(path, values, facts)
    maps = {"sigma": load_volume(sigma), "kappa": load_volume(kappa)}
    if any(one.shape != values.shape for one in maps.values()):
        return OpenedVolume(path, values, facts)
    rows = tuple(csv.DictReader(read_text(table).splitlines())) if table.exists() else ()
    return OpenedVolume(path, values, facts, maps, rows)


def region_words(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the table of regions as rich text; empty without regions."""
    if not rows:
        return ""
    heads = ("Region", "Sum", "\u00b1", "noise", "H", "object")
    keys = ("label", "sum", "sigma", "sigma_noise", "sigma_h", "sigma_object")
    cells = ["".join(f"<td align='right'>{escape(row.get(key, ''))}</td>" for key in keys) for row in rows]
    lines = ["".join(f"<th align='right'>{head}</th>" for head in heads), *cells]
    return "<table cellspacing='4'>" + "".join(f"<tr>{one}</tr>" for one in lines) + "</table>"


def _planes_in(path: Path) -> int | None:
    """Return the number of planes in a file: 1 in a light field, more in a volume; None: it is an H."""
    from lfcal.frames import open_image

    if path.suffix.lower() in VOLUMES_ALONE:
        with H5File(path, only=(DATASET,)) as file:
            return 2 if DATASET in file else None
    if path.suffix.lower() == ".npy" and map_npy(path).ndim > 3:
        return None
    image = open_image(path)
    image.close()
    return image.pages


@dataclass(frozen=True, eq=False)
class Synthetic:
    """A synthetic light field: its file, and the volume it shows."""

    path: str
    truth: NDArray[np.float32]


def synthetic_shape(H: PSFMatrix) -> tuple[int, int]:
    """Return a size for a synthetic light field: several periods and two cutouts, small enough to solve quickly."""
    rows, columns = (int(min(LARGEST, max(4 * n, 2 * c))) for n, c in zip(H.shape[1:3], H.shape[3:], strict=True))
    return rows, columns


def make_light_field(
    H: PSFMatrix, name: str, path: str, *, shape: tuple[int, int] | None = None, counts: float = COUNTS, seed: int = 0
) -> Synthetic:
    """Project the phantom ``name`` through ``H``, add photon noise, and write the image as a 16-bit TIFF.

    Parameters
    ----------
    H
        The matrix to project with.
    name
        One of `lfcal.reconstruct.phantoms.PHANTOMS`.
    path
        Image file to write (.tif).
    shape
        Rows and columns; by default `synthetic_shape`.
    counts
        Value of the brightest pixel before noise is added; each count is one photon.
    seed
        Seed of phantom and noise.
    """
    from lfcal.base import write_tiff
    from lfcal.reconstruct import Projector, phantom

    if not path.lower().endswith((".tif", ".tiff")):
        raise InputError.expected("light field", "a .tif file", Path(path).name, "end the name of the file with .tif")
    P = Projector(H, shape or synthetic_shape(H))
    volume = phantom(name, P.volume_shape, seed)
    image = P.forward(volume)
    top = float(image.max())
    if not top > 0:
        raise InputError.expected("light field", "light", "none", "this H is empty; assemble it again")
    scale = counts / top
    noisy = np.random.default_rng(seed).poisson(np.maximum(image * scale, 0))
    write_tiff(path, np.minimum(noisy, 65535).astype(np.uint16))
    return Synthetic(path, (volume * scale).astype(np.float32))


# -- projector ------------------------------------------------------------------------------------------
def projector_for(
    matrices: Sequence[PSFMatrix],
    shape: tuple[int, int],
    settings: ReconstructSettings,
    view: Resampling | None = None,
) -> Any:
    """Return the projector for the used region of a light field and its margin, within the memory that solvers leave.

    Parameters
    ----------
    matrices
        H, and those of other regions.
    shape
        Rows and columns of the full image, after resampling by ``view``.
    settings
        The user's settings.
    view
        How the light field was resampled.
    """
    from lfcal.reconstruct import room_for_projections

    H, choice = matrices[0], settings.choice_for(matrices[0], shape)
    rows, columns = settings.window(shape)
    used = rows.stop - rows.start, columns.stop - columns.start
    row, column = settings.place(H, view)
    optics = replace(settings.optics(H.path), anchor=(row - rows.start, column - columns.start))
    wide = (used[0] + 2 * choice.margin, used[1] + 2 * choice.margin)
    most = None if settings.memory is None else int(settings.memory * 1e9)
    room = room_for_projections((len(H), *wide), choice, 8 if settings.double else 4, memory=most)
    return optics.projector(matrices, used, None, choice.margin, memory=room, workers=None, device=settings.device)


class SolvingForecast(NamedTuple):
    """Forecast of a reconstruction: time (s), and all costs as rich text."""

    seconds: float
    words: str


def forecast_for(H: PSFMatrix, shape: tuple[int, int], settings: ReconstructSettings) -> SolvingForecast:
    """Return the forecast for a reconstruction of a light field of ``shape``."""
    view = settings.view(H, shape)
    shape = shape if view is None else view.shape
    with ExitStack() as stack:
        matrices = settings.optics(H.path, mat_order_of(H)).open(stack) if settings.other_regions else [H]
        return outlook_of(projector_for(matrices, shape, settings, view), settings.choice_for(H, shape))


def outlook_of(P: Any, choice: SolverChoice) -> SolvingForecast:
    """Return the forecast for a reconstruction with a projector."""
    from lfcal.reconstruct import run_memory

    found, iterations, memory = P.forecast(), choice.iterations, run_memory(P, choice)
    cost = found.chosen
    nz, ny, nx = P.volume_shape
    total = cost.prepare_s + iterations * cost.pair_s
    margin = choice.margin
    rows = [
        ("Volume", f"{nx - 2 * margin} × {ny - 2 * margin} × {nz} voxels"),
        ("Margin", f"{margin} px around" if margin else "none"),
        ("Projector", cost.method + ("" if cost.resident else ", prepared for each projection")),
        ("Device", "processor" if P.device is None else P.device.name),
        ("Set-up", format_seconds(cost.prepare_s)),
        ("Forward, adjoint", f"{format_seconds(cost.forward_s)}, {format_seconds(cost.adjoint_s)}"),
        (f"{iterations} iterations{' at most' if choice.auto else ''}", f"about {format_seconds(total)}"),
        ("Memory", format_bytes(memory.total)),
        ("for H, the solver", f"{format_bytes(memory.matrix)}, {format_bytes(memory.solver)}"),
    ]
    others = [f"{o.method} {format_seconds(o.pair_s)}" for o in found.options if o.method != cost.method]
    if others:
        rows.append(("Other projectors", ", ".join(others) + " (forward and adjoint)"))
    cells = "".join(f"<tr><td style='padding-right:8px'>{a}</td><td><b>{b}</b></td></tr>" for a, b in rows)
    return SolvingForecast(total, f"<table cellspacing='1'>{cells}</table>")


# -- run ------------------------------------------------------------------------------------------------
class Placed(NamedTuple):
    """A volume ``(nz, Y, X)`` to save, the sides of its voxels (rows, columns; µm) and its provenance."""

    volume: NDArray[Any]
    voxel_um: tuple[float, float] | None
    details: dict[str, Any]


class Solving:
    """Reconstruction of one light field: its projector, and the progress of the solver.

    The solving thread replaces `history` and `state` as a whole. Other threads may read them.

    Parameters
    ----------
    psf
        H file; the work opens it itself.
    image
        The whole light field ``(rows, columns)``.
    settings
        Settings of the reconstruction.
    truth
        True volume ``(nz, rows, columns)`` of a synthetic light field; None if unknown.
    mat_order
        As in `lfcal.psf.open_psf`.
    """

    def __init__(
        self,
        psf: str,
        image: NDArray[Any],
        settings: ReconstructSettings,
        truth: NDArray[np.float32] | None = None,
        *,
        mat_order: str = "",
    ) -> None:
        self.psf, self.image, self.settings, self._truth = psf, image, settings, truth
        self.mat_order = mat_order
        self.history: tuple[SolverProgress, ...] = ()
        self.errors: tuple[float, ...] = ()
        """Error relative to the truth (NRMSE) after each iteration, if the truth is known."""
        self.state: SolverState | None = None
        self.notes: tuple[str, ...] = ()
        self.stopped, self.chi2 = "", float("nan")
        self.depths: NDArray[np.float64] | None = None
        self.voxel_um: tuple[float, float] | None = None
        self._projector: Any = None
        self._margin = 0
        self._view: Resampling | None = None
        self._said: tuple[str, ...] = ()
        self._matrices: list[PSFMatrix] = []
        self._open = ExitStack()
        self._stop = threading.Event()

    @property
    def window(self) -> tuple[slice, slice]:
        """Used rows and columns of the light field, after resampling if necessary."""
        return self.settings.window(self._shape)

    @property
    def _shape(self) -> tuple[int, int]:
        """Shape (rows, columns) of the light field, after resampling if necessary."""
        rows, columns = self.image.shape[:2] if self._view is None else self._view.shape
        return rows, columns

    @property
    def pixels(self) -> int:
        """Number of pixels used."""
        rows, columns = self.window
        used: int = (rows.stop - rows.start) * (columns.stop - columns.start)
        return used

    @property
    def truth(self) -> NDArray[np.float32] | None:
        """The true volume, or None if it is not known."""
        if self._truth is None or self.state is None:
            return None
        truth: NDArray[np.float32] = self._truth[(slice(None), *self.window)]
        return truth if truth.shape == self.volume.shape else None

    @property
    def volume(self) -> NDArray[Any]:
        """Volume ``(nz, rows, columns)`` of the region without margin; requires a started run."""
        assert self.state is not None
        return cropped(self.state.volume, self._margin)

    def words(self) -> str:
        """Return a summary of the run as lines of rich text; empty before the first iteration."""
        if not self.history or self.state is None:
            return ""
        last, truth = self.history[-1], self.truth
        lines = [
            f"{self.state.iteration} iterations in {format_seconds(last.seconds)}, misfit {100 * last.residual:.3g} %"
        ]
        if math.isfinite(self.chi2):
            lines.append(f"chi2 per pixel {self.chi2:.3g}")
        if truth is not None and truth.any():
            lines.append(f"error relative to the truth: NRMSE {nrmse(self.volume, truth):.3f}")
        return "<br>".join((*lines, *((self.stopped,) if self.stopped else ()), *self.notes))

    def stop(self) -> None:
        """Stop after the current iteration. The volume is kept, and `work` continues from it."""
        self._stop.set()

    @property
    def stopping(self) -> bool:
        """Whether a stop was requested."""
        return self._stop.is_set()

    def fits(self, psf: str, settings: ReconstructSettings, mat_order: str = "") -> bool:
        """Return whether the run can continue with ``settings``.

        Only iterations, the voxels to save, and settings of error bars may differ.
        """
        free = {key: getattr(self.settings, key) for key in ("iterations", "voxel", *BARS)}
        same = replace(settings, **free)
        return (psf, mat_order) == (self.psf, self.mat_order) and same == self.settings

    def work(self, iterations: int | None = None) -> Work[SolverState | None]:
        """Iterate ``iterations`` times, by default as often as in the settings; continue after an earlier call."""
        self._stop.clear()  # at the call, not in the thread: a stop asked for before the thread starts then counts
        return self._work(iterations)

    def _work(self, iterations: int | None) -> Work[SolverState | None]:
        yield from self._prepare()
        if self._stop.is_set():
            return self.state
        settings = self.settings if iterations is None else self.settings.changed("iterations", iterations)
        choice = replace(settings.choice(), margin=self._margin)
        self.stopped, self.chi2 = "", float("nan")
        image = cleaner(settings.light_field, self._view)(self.image)
        weights = None if self._view is None else self._view.inside((self.image.shape[0], self.image.shape[1]))
        running = iter_solve(self._projector, image[self.window], choice, weights=weights, resume=self.state)
        try:
            while True:
                record = next(running)
                if isinstance(record, SolverProgress):
                    self.state = record.state
                    truth = self.truth
                    if truth is not None and truth.any():
                        self.errors = (*self.errors, float(nrmse(self.volume, truth)))
                    self.history = (*self.history, record)
                yield record
                if self._stop.is_set():
                    break
        except StopIteration as end:
            # a run with a stopping rule returns its best estimate, from an earlier iteration
            self.notes, self.stopped, self.state = (
                (*self._said, *end.value.notes),
                end.value.stopped,
                end.value.state,
            )
            self.chi2 = end.value.chi2
        finally:
            running.close()
        return self.state

    def _prepare(self) -> Work[None]:
        if self._projector is not None:
            return
        from lfcal.psf import voxel_um

        if not self._matrices:
            self._matrices = self.settings.optics(self.psf, self.mat_order).open(self._open)
        H, shape = self._matrices[0], (self.image.shape[0], self.image.shape[1])
        self._view, self._said = self.settings.view(H, shape), ()
        if self._view is not None:
            self._said = (f"{drift_words(self._view, shape)}: the light field is resampled to this period",)
        elif note := drift_note(H.camera, H.period, shape):
            self._said = (f"warning: {note.partition(':')[0]}, and the volume shows ghosts",)
        self._margin = self.settings.choice_for(H, self._shape).margin
        projector = projector_for(self._matrices, self._shape, self.settings, self._view)
        if not self.settings.choice().solver.in_parts:
            for record in projector.iter_prepare():
                yield record
                if self._stop.is_set():
                    return
        self.depths = projector.known_depths
        if projector.camera is not None:
            self.voxel_um = voxel_um(H)
        self._projector = projector

    def placed(self, settings: ReconstructSettings) -> Placed:
        """Return the volume to save, with the voxel size of ``settings``.

        Raises
        ------
        InputError
            As `ReconstructSettings.grid`.
        """
        asked = replace(self.settings, voxel=settings.voxel)
        grid = asked.grid(self._matrices[0], self._shape, self._view)
        if grid is None:
            return Placed(self.volume, self.voxel_um, self.details())
        details = {**self.details(), "voxel_um": grid.voxel_um, "origin_um": grid.origin_um}
        return Placed(grid.apply(self.volume), (grid.voxel_um, grid.voxel_um), details)

    def details(self) -> dict[str, Any]:
        """Return the provenance that is saved with a volume."""
        last = self.history[-1] if self.history else None
        count = 0 if self.state is None else self.state.iteration
        return {
            "psf": self.psf,
            "settings": {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self.settings).items()},
            "iterations": count,
            "margin": self._margin,
            "stopped": self.stopped,
            "residual": None if last is None else last.residual,
            "notes": list(self.notes),
        }

    def close(self) -> None:
        """Close H; the volume stays."""
        self._open.close()
        self._matrices, self._projector = [], None
