"""Reconstruct light-field frames from files to volume files: one frame or a series, in this process or in units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfcal.base import InputError, Work, note, worker_count
from lfcal.psf import PSFMatrix, noise_of, voxel_um
from lfcal.reconstruct._frame_units import device_hints, frame_units, iter_collect
from lfcal.reconstruct.frame_files import FrameFile, Save, Saved, cleaner, frames_of, placed_anchor, saving
from lfcal.reconstruct.margin import usual_margin
from lfcal.reconstruct.memory import RunMemory, room_for_projections, run_memory
from lfcal.reconstruct.metric_grid import MetricGrid
from lfcal.reconstruct.optics import SharedOptics, wide
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.resample import Resampling, resampling_for
from lfcal.reconstruct.series import FrameResult, check_any, check_warm, iter_series
from lfcal.reconstruct.solvers import Reconstruction, SolverChoice
from lfcal.records import VoxelGrid
from lfcal.work import RunChoice, iter_made

__all__ = ["FrameRun", "memory_for"]

USUAL = 20
"""Number of iterations assumed in a forecast of a run that stops automatically; half or twice as many are possible."""


@dataclass(frozen=True)
class FrameRun:
    """Reconstruction of a series of frames, with all its settings and data.

    Attributes
    ----------
    frames, matrices
        The frames, and the H of each region.
    view
        Resampling of frames to the period of H. None: frames are used unchanged.
    optics, choice, voxels
        Settings, completed by the position of the frames, the margin and the noise.
    warm
        Whether each frame starts from the volume of the previous frame.
    projector
        Projector for the resampled frames, extended by the margin if there is one.
    """

    frames: list[FrameFile]
    matrices: list[PSFMatrix]
    view: Resampling | None
    optics: SharedOptics
    choice: SolverChoice
    voxels: VoxelGrid
    warm: bool
    projector: Projector

    @classmethod
    def of(
        cls,
        frames: Path,
        matrices: list[PSFMatrix],
        optics: SharedOptics,
        choice: SolverChoice,
        voxels: VoxelGrid,
        *,
        warm: bool = False,
        workers: int | None = None,
    ) -> FrameRun:
        """Return a run prepared from the first frame; ``matrices`` is the result of ``optics.open``.

        ``frames`` is an image file, a folder or a session, as in `frames_of`, and ``workers`` is the number of threads.
        The other arguments are as in the attributes.
        """
        if warm:
            check_warm(choice)
        found, H, asked = frames_of(frames), matrices[0], optics.light_field.asked
        anchor = voxels.anchor or placed_anchor(frames, H, asked)
        rows, columns = found[0].read().shape
        placed = "--region" if optics.regions else "--anchor" if voxels.anchor else "the session" if anchor else ""
        view = resampling_for(H, (rows, columns), optics.light_field, placed, quiet=False)
        optics = replace(optics, anchor=anchor, resample=view is not None)
        shape = (rows, columns) if view is None else view.shape
        margin = voxels.margin
        if isinstance(margin, str):
            possible = "weights" in choice.solver.honours
            margin = usual_margin(H.period, (H.shape[3], H.shape[4]), shape) if possible else 0
        noise = noise_of(H.provenance)
        known = None if noise is None or noise.slope == 0 else (noise.floor, noise.slope)
        choice = replace(choice, margin=margin, noise=known)
        room = _room(optics, choice, len(H), wide(shape, margin), warm)
        how: dict[str, Any] = {"memory": room, "workers": workers, "device": optics.projection.device}
        projector = optics.projector(matrices, (rows, columns), view, margin, **how)
        return cls(found, matrices, view, optics, choice, voxels, warm, projector)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the images, without margin."""
        rows, columns = self.projector.image_shape
        return rows - 2 * self.choice.margin, columns - 2 * self.choice.margin

    @property
    def iterations(self) -> int:
        """Number of iterations per frame; an estimate if the run stops automatically."""
        return min(self.choice.iterations, USUAL) if self.choice.auto else self.choice.iterations

    @property
    def seconds(self) -> float:
        """Estimated time for all frames, including set-up (s)."""
        found = self.projector.forecast().chosen
        return found.prepare_s + len(self.frames) * self.iterations * found.pair_s

    @property
    def memory(self) -> RunMemory:
        """Forecast of the peak memory of the run."""
        return run_memory(self.projector, self.choice, warm=self.warm)

    @property
    def volume_shape(self) -> tuple[int, ...]:
        """Shape ``(nz, Y, X)`` of a stored volume."""
        grid = self._grid
        return (len(self.matrices[0]), *(self.shape if grid is None else grid.shape))

    @cached_property
    def _grid(self) -> MetricGrid | None:
        """Grid of voxels of one size; None if none is requested."""
        side, H = self.voxels.voxel, self.matrices[0]
        if side is None:
            return None
        anchor = self.optics.anchor
        return MetricGrid.for_matrix(H, self.shape, anchor, None if isinstance(side, str) else side, self.view)

    @property
    def details(self) -> dict[str, Any]:
        """Metadata of the reconstruction for the volume files."""
        P, choice = self.projector, self.choice
        anchor = tuple(at - choice.margin for at in P.grid.anchor)
        known: dict[str, Any] = {"psf": self.optics.psf.name, "solver": asdict(choice), "method": P.method}
        known |= {"within": P.tolerance, "anchor": anchor}
        if P.device is not None:
            known["device"] = P.device.name
        if self.optics.regions:
            known["regions"] = [one.region or Path(one.path).name for one in self.matrices]
        return known

    def iter_volumes(
        self,
        targets: Mapping[str, Path],
        out: Path,
        details: Mapping[str, Any],
        run: RunChoice | None = None,
        *,
        of_frames: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> Work[tuple[FrameResult, ...]]:
        """Reconstruct and save the frames, and return their results.

        Parameters
        ----------
        targets
            File for the volume of each frame, by the frame's name.
        out
            Path of the result; with ``run``, the results of finished frames are stored next to it until the run is
            complete.
        details
            Additional metadata to store in all files.
        run
            Where and how to run the work units, one per frame. None: reconstruct one frame after another in this
            thread, with only one volume in memory.
        of_frames
            Additional metadata of each frame, by its name. None: there are none.
        """
        grid = self._grid
        sides = voxel_um(self.matrices[0]) if grid is None else (grid.voxel_um, grid.voxel_um)
        times, said = [frame.time_s for frame in self.frames], {**self.details, **details}
        how: dict[str, Any] = {"grid": grid, "times_s": times, "of_frames": of_frames}
        saved = partial(saving, self.projector, sides, targets, said, self.volume_shape, **how)
        if run is not None:
            return (yield from self._iter_units(out, run, saved))
        with saved() as save:
            return (yield from self._iter_here(save))

    def _iter_here(self, save: Save) -> Work[tuple[FrameResult, ...]]:
        P, choice, light_field = self.projector, self.choice, self.optics.light_field
        rows, columns = self.frames[0].read().shape
        weights = None if self.view is None else self.view.inside((rows, columns))
        clean = cleaner(light_field, self.view)

        def read(frame: FrameFile) -> NDArray[Any]:
            return clean(frame.read((rows, columns)))

        def take(name: str, result: Reconstruction) -> None:
            known = {"notes": result.notes, "residual": result.history[-1].residual, "stopped": result.stopped}
            if math.isfinite(result.chi2):
                known["chi2"] = result.chi2
            save(name, result.volume, known)

        def leave(name: str) -> None:
            save(name, None, {})

        note(f"{P.forecast()}; memory {self.memory}")
        if not choice.solver.in_parts:
            yield from P.iter_prepare()
        how: dict[str, Any] = {"weights": weights, "warm": self.warm, "missing": leave}
        frames = [(frame.name, partial(read, frame)) for frame in self.frames]
        return (yield from iter_series(P, frames, len(frames), choice, take, **how))

    def _iter_units(self, out: Path, run: RunChoice, saved: Saved) -> Work[tuple[FrameResult, ...]]:
        """Reconstruct the frames as units; each volume is in a separate file until all are finished and ``saved``."""
        if self.warm and run.executor != "threads":
            raise InputError.expected(
                "frames that start from the previous volume (--warm)",
                "threads in one process (--executor threads)",
                run.executor,
                "choose threads, or start each frame from the beginning (without --warm)",
            )
        # each process has its own H
        share = 1 if run.executor == "threads" else worker_count(run.workers)
        P, optics = self.projector, self.optics
        room = memory_for(self, share)
        hints = {"memory": room, **device_hints(P.device, optics.projection.device, share)}
        units = frame_units(self.frames, optics, self.choice, out, hints, P.recipe, warm=self.warm)
        results: list[FrameResult] = []
        names = [frame.name for frame in self.frames]
        collect = partial(iter_collect, names=names, saved=saved, results=results)
        yield from iter_made(units, out, run, collect, title=f"volumes of {out.name}", joined=False)
        check_any(results)
        return tuple(results)


def memory_for(run: FrameRun, share: int) -> int:
    """Return the memory that projections of ``run`` may use in each of ``share`` processes (bytes)."""
    planes = len(run.matrices[0])
    return _room(run.optics, run.choice, planes, run.projector.image_shape, run.warm, share)


def _room(
    optics: SharedOptics, choice: SolverChoice, planes: int, shape: Sequence[int], warm: bool, share: int = 1
) -> int:
    """Return the memory that projections of images of ``shape`` may use in each of ``share`` processes (bytes)."""
    own = optics.projection
    most = None if own.memory is None else int(own.memory * 1e9)
    sizes = (planes, shape[0], shape[1])
    return room_for_projections(sizes, choice, 8 if own.double else 4, memory=most, warm=warm, share=share)
