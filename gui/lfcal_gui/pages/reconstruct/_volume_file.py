"""The volume of the project: written to its file, read from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QObject, Signal

from lfcal_gui.base_page import BasePage
from lfcal_gui.models import Taken
from lfcal_gui.pages.reconstruct.model import ReconstructSettings
from lfcal_gui.pages.reconstruct.model_solving import Solving
from lfcal_gui.pages.reconstruct.step import step
from lfcal_gui.saving import ask_target

__all__ = ["VolumeFile"]

VOLUMES = (
    "TIFF stack, opens in ImageJ (*.tif);;OME-TIFF with depths (*.ome.tif);;OME-Zarr, a folder (*.ome.zarr);;"
    "HDF5 (*.h5);;numpy (*.npy)"
)


class VolumeFile(QObject):
    """Reads and writes beside the window's thread.

    Signals
    -------
    loaded(path, volume, facts)
        The project's volume ``(z, Y, X)`` was read, and the `lfcal.reconstruct.VolumeFacts` of its file.
    """

    loaded = Signal(str, object, object)

    def __init__(self, page: BasePage) -> None:
        super().__init__(page)
        self._page, self._context = page, page.context

    def save(self, solving: Solving, path: str = "") -> None:
        """Write what was reconstructed; asks for a name where none is given."""
        from lfcal.reconstruct import save_volume

        if solving.state is None:
            return
        path = path or ask_target(self._page, "Save volume", "volume.tif", VOLUMES)
        if not path:
            return
        depths, settings = solving.depths, ReconstructSettings.of(self._context.state)

        def write() -> str:
            placed = solving.placed(settings)
            save_volume(path, placed.volume, depths_um=depths, voxel_um=placed.voxel_um, details=placed.details)
            return path

        taken, begun = self._taken(solving, path), self._context.project.begun
        self._context.jobs.compute(
            "reconstruct save", write, lambda path: self._saved(path, taken, begun), self._page.refuse
        )

    def _taken(self, solving: Solving, path: str) -> Taken:
        """Return the reconstruction, with all its iterations, for the history."""
        count = 0 if solving.state is None else solving.state.iteration
        state = replace(self._context.state, psf=solving.psf)
        voxel = ReconstructSettings.of(state).voxel
        state = replace(state, settings=replace(solving.settings, iterations=count, voxel=voxel).into(state))
        title = f"Reconstruct {Path(path).name} by {solving.settings.solver}"
        return self._context.taken("reconstruct", title, path, lambda: step(state, path))

    def _saved(self, path: str, taken: Taken, begun: int) -> None:
        self._context.history.add(taken)
        self._context.message.emit(f"volume saved as {path}")
        if begun == self._context.project.begun:  # else it is of a project that is no longer open
            self._context.project.update("reconstruction", volume=path)

    def load(self) -> None:
        """Read the project's volume if there is one."""
        from lfcal.reconstruct import load_volume, volume_facts

        path = self._context.state.volume
        self._context.jobs.drop("reconstruct volume")
        if path and Path(path).exists():
            self._context.jobs.load(
                "reconstruct volume",
                lambda: (load_volume(path), volume_facts(path)),
                lambda found: self.loaded.emit(path, *found),
                self._page.refuse,
            )
