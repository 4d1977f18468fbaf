"""What all frames of a reconstruction share: H of one or several regions, and how frames are brought onto it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError
from lfcal.records import LightFieldSettings, ProjectionSettings, from_dict, to_dict
from lfcal.tasks.matrices import open_matrix
from lfcal.tasks.notes import note, warn
from lfcal.tasks.outputs import files_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Camera
    from lfcal.lattice import LatticeFit
    from lfcal.psf import PSFMatrix
    from lfcal.reconstruct import Projector, Resampling
    from lfcal.reconstruct.projectors import ArrayDevice

__all__ = ["ALL", "SharedOptics", "files_of_regions", "known_view", "view_for", "view_of"]

Anchor = tuple[float, float]

ALL = "all"
"""Every region that the H file has."""


@dataclass(frozen=True)
class SharedOptics:
    """H, how frames are brought onto it, and how it is applied.

    Attributes
    ----------
    psf, regions, mat_order, light_field, projection
        As in `lfcal.tasks.Reconstruct`.
    anchor
        Pixel of a frame on which position (0, 0) of H is imaged; None: that of H.
    resample
        Whether frames are resampled.
    """

    psf: Path
    regions: tuple[str, ...]
    mat_order: str
    light_field: LightFieldSettings
    projection: ProjectionSettings
    anchor: Anchor | None = None
    resample: bool = False

    @property
    def inputs(self) -> tuple[str, ...]:
        """The files among them; of a folder its images."""
        own = self.light_field
        others = [str(path) for path in (own.dark, own.white, own.lattice)]
        found = (str(self.psf), *map(str, files_of_regions(self.psf, self.regions)), *others)
        return tuple(os.path.abspath(file) for path in found for file in sorted(files_of(path)))

    def plain(self) -> dict[str, Any]:
        """Return what decides the volumes as plain JSON types, with absolute paths."""
        light_field = to_dict(self.light_field)
        for name in ("dark", "white", "lattice"):
            light_field[name] = os.path.abspath(light_field[name]) if light_field[name] else ""
        others = {str(path): os.path.abspath(path) for path in files_of_regions(self.psf, self.regions)}
        return {
            "psf": os.path.abspath(self.psf),
            "regions": [others.get(str(Path(name)), name) for name in self.regions],
            "mat_order": self.mat_order,
            "light_field": light_field,
            # where it is computed decides how fast it is
            "projection": to_dict(replace(self.projection, device="auto", memory=None)),
            "anchor": self.anchor,
            "resample": self.resample,
        }

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> SharedOptics:
        """Return what `plain` gave."""
        return cls(
            Path(values["psf"]),
            tuple(values["regions"]),
            values["mat_order"],
            from_dict(LightFieldSettings, values["light_field"]),
            from_dict(ProjectionSettings, values["projection"]),
            None if values["anchor"] is None else tuple(values["anchor"]),
            values["resample"],
        )

    def open(self, stack: ExitStack, *, quiet: bool = False) -> list[PSFMatrix]:
        """Return H of the file and of each other region, which ``stack`` closes."""
        places = [(self.psf, ""), *_places(self.psf, self.regions)]
        return [
            stack.enter_context(open_matrix(file, region=region, mat_order=self.mat_order, quiet=quiet))
            for file, region in places
        ]

    def view(self, H: PSFMatrix, shape: tuple[int, int]) -> Resampling | None:
        """Return the map of frames of ``shape`` onto H's period as it was found; None: they are used as they are."""
        white, lattice = paths_of(self.light_field)
        return known_view(H, shape, white, lattice, quiet=True) if self.resample else None

    def image_anchor(self, view: Resampling | None, H: PSFMatrix) -> Anchor | None:
        """Return the anchor of the images: as given, where resampling puts it, or None for that of H."""
        from lfcal.reconstruct import lattice_anchor_of

        if self.anchor is not None or view is None:
            return self.anchor
        return view.anchor(lattice_anchor_of(H))

    def projector(
        self,
        matrices: Sequence[PSFMatrix],
        frame: tuple[int, int],
        view: Resampling | None,
        margin: int,
        *,
        memory: int,
        workers: int | None,
        device: str | ArrayDevice,
        method: str = "",
    ) -> Projector:
        """Return the projector of frames with ``margin`` pixels around, with less noise where that of H is known.

        ``method``: the way to project in place of that of the settings.
        """
        from lfcal.reconstruct import FieldProjector, Projector

        H, own, anchor = matrices[0], self.projection, self.image_anchor(view, matrices[0])
        shape = frame if view is None else view.shape
        if margin:
            row, column = H.anchor if anchor is None else anchor
            shape, anchor = wide(shape, margin), (row + margin, column + margin)
        settings: dict[str, Any] = {
            "dtype": "float64" if own.double else "float32",
            "threshold": own.threshold,
            "tolerance": own.within,
            "memory_limit": memory,
            "workers": workers,
            "device": device,
        }
        way = method or own.method
        if len(matrices) == 1:
            return Projector(H, shape, anchor, way, **settings).denoised()
        return FieldProjector(matrices, shape, anchor, way, **settings).denoised()


def wide(shape: tuple[int, int], margin: int) -> tuple[int, int]:
    """Return ``shape`` with ``margin`` pixels around."""
    return shape[0] + 2 * margin, shape[1] + 2 * margin


def files_of_regions(psf: Path, regions: Sequence[str]) -> list[Path]:
    """Return the H files that ``regions`` name besides ``psf``, each once."""
    found = [Path(file) for file, _ in _places(psf, regions) if file != psf]
    return list(dict.fromkeys(found))


def _places(psf: Path, regions: Sequence[str]) -> list[tuple[Path, str]]:
    """Return file and region of each of ``regions``: a region of ``psf`` by its name, or another file.

    Raises
    ------
    InputError
        If it is neither.
    """
    from lfcal.psf import regions_of

    if not regions:
        return []
    own = regions_of(psf)
    found: list[tuple[Path, str]] = []
    for name in regions:
        if name == ALL:
            found += [(psf, region) for region in own[1:]]
        elif name in own:
            found += [(psf, name)] if name != own[0] else []
        elif Path(name).exists():
            found.append((Path(name), ""))
        else:
            named = ", ".join(filter(None, own)) or "none by name"
            raise InputError.expected("--region", f"a region of {psf.name} ({named}) or an H file", name, "correct it")
    if not found:
        raise InputError.expected("--region", f"other regions than the first of {psf.name}", "none", "leave it out")
    return found


def view_for(
    H: PSFMatrix, shape: tuple[int, int], light_field: LightFieldSettings, placed: str, *, quiet: bool = False
) -> Resampling | None:
    """Return the map of frames of ``shape`` onto H's period; None: they are used as they are.

    Unless it is asked for, frames are resampled where the lattice drifts by more than `MOST_DRIFT` over the frame, as
    far as lfcal knows it. ``placed``: what gives the place of frames in H, so that they cannot be moved.
    ``quiet``: say nothing of it.
    """
    from lfcal.reconstruct import MOST_DRIFT, drift_words

    white, lattice = paths_of(light_field)
    if light_field.asked:
        return view_of(H, white, lattice)
    view = known_view(H, shape, white, quiet=quiet)
    if view is None or view.drift(shape) <= MOST_DRIFT:
        return None
    if quiet:
        return view if light_field.asked is None and not placed else None
    words = drift_words(view, shape)
    if light_field.asked is None and not placed:
        note(f"{words}; frames are resampled to it (--resample never uses them as they are)")
        return view
    remedy = f"frames whose place is given by {placed} are not resampled" if placed else ""
    warn(f"{words}, and volumes show ghosts; {remedy or 'leave --resample never out to resample frames'}")
    return None


def paths_of(light_field: LightFieldSettings) -> tuple[Path | None, Path | None]:
    """Return white image and lattice."""
    white, lattice = (Path(path) if path else None for path in (light_field.white, light_field.lattice))
    return white, lattice


def known_view(
    H: PSFMatrix, shape: tuple[int, int], white: Path | None, lattice: Path | None = None, *, quiet: bool = False
) -> Resampling | None:
    """Return the map by a measured lattice, that of the white frame, or else that of H's camera; None: unknown."""
    from lfcal.reconstruct import Resampling, lattice_anchor_of

    if lattice is not None:
        return view_of(H, white, lattice)
    if white is not None:
        try:
            return view_of(H, white)
        except InputError as error:
            if not quiet:
                note(f"no lattice is measured in the white image; {error}")
    if H.camera is None or shape != H.camera.sensor.shape:
        return None
    return Resampling.of_camera(H.camera, H.period, lattice_anchor_of(H))


def view_of(H: Any, white: Path | None, lattice: Path | None = None) -> Resampling:
    """Return the map of frames onto H's period, by a measured lattice, the white frame's or H's camera's."""
    from lfcal.frames.corrections import read_average
    from lfcal.reconstruct import Resampling, lattice_anchor_of

    if lattice is not None:
        from lfcal.lattice import load_lattice

        fit = load_lattice(lattice)
        kind = fit.kind if H.camera is None else H.camera.lattice.kind
        if fit.kind != kind:
            raise InputError.expected(str(lattice), f"the {kind} lattice of H", fit.kind, "use its own camera's")
    elif white is None and H.camera is not None:
        return Resampling.of_camera(H.camera, H.period, lattice_anchor_of(H))
    elif white is None:
        raise InputError.expected(
            "--resample", "a white frame, a lattice, or a camera with H", "none", "give --white or --lattice"
        )
    else:
        from lfcal.lattice import fit_lattice

        fit = fit_lattice(read_average(white), kind=None if H.camera is None else H.camera.lattice.kind)
    if H.camera is None or len(H.camera.lattice.types) == 1:
        return Resampling.of_fit(fit, H.period, lattice_anchor_of(H))
    measured = _measured(H.camera, fit, None if white is None else read_average(white))
    return Resampling.of_camera(measured, H.period, lattice_anchor_of(H))


def _measured(camera: Camera, fit: LatticeFit, white: NDArray[np.float32] | None) -> Camera:
    """Return ``camera`` of three lens types with the lattice of ``fit``: a lenslet of type 0 is at its offset.

    The white frame shows which one that is; without it, or where it does not, it is the nearest to the offset stated.
    """
    from lfcal.lattice import classify_lens_types, expected_blur

    lattice = fit.to_lattice(camera)
    if white is not None:
        try:
            lattice = classify_lens_types(white, fit, expected_blur(camera)).to_lattice(fit, camera)
        except InputError as error:
            note(f"lens types are taken as H's camera states them; {error}")
    return replace(camera, lattice=lattice)
