"""Settings shared by all frames of a reconstruction: H of one or several regions, and resampling to its period."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lfcal.base import InputError
from lfcal.frames import files_of
from lfcal.psf import PSFMatrix, open_psf, regions_of
from lfcal.reconstruct.projectors import ArrayDevice, FieldProjector, Projector
from lfcal.reconstruct.resample import Resampling, lattice_anchor_of, resampling_for
from lfcal.records import LightFieldSettings, ProjectionSettings, from_dict, to_dict

__all__ = ["SharedOptics", "files_of_regions", "wide"]

Anchor = tuple[float, float]

ALL = "all"
"""All regions in the H file."""


@dataclass(frozen=True)
class SharedOptics:
    """Settings shared by all frames: H, resampling to its period, and the computation of projections.

    Attributes
    ----------
    psf, regions, mat_order, light_field, projection
        As in `lfcal.tasks.Reconstruct`.
    anchor
        Pixel (row, column) of a frame onto which position (0, 0) of H is imaged. None: the anchor of H.
    resample
        Whether frames are resampled to the period of H.
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
        """Absolute paths of the files that these settings name; for a folder, the paths of its images."""
        own = self.light_field
        others = [str(path) for path in (own.dark, own.white, own.mask, own.lattice)]
        found = (str(self.psf), *map(str, files_of_regions(self.psf, self.regions)), *others)
        return tuple(os.path.abspath(file) for path in found for file in sorted(files_of(path)))

    def plain(self) -> dict[str, Any]:
        """Return the settings that affect the volumes as plain JSON types, with absolute paths."""
        light_field = to_dict(self.light_field)
        for name in ("dark", "white", "mask", "lattice"):
            light_field[name] = os.path.abspath(light_field[name]) if light_field[name] else ""
        others = {str(path): os.path.abspath(path) for path in files_of_regions(self.psf, self.regions)}
        return {
            "psf": os.path.abspath(self.psf),
            "regions": [others.get(str(Path(name)), name) for name in self.regions],
            "mat_order": self.mat_order,
            "light_field": light_field,
            # the device affects only the speed
            "projection": to_dict(replace(self.projection, device="auto", memory=None)),
            "anchor": self.anchor,
            "resample": self.resample,
        }

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> SharedOptics:
        """Return the settings from the result of `plain`."""
        return cls(
            Path(values["psf"]),
            tuple(values["regions"]),
            values["mat_order"],
            from_dict(LightFieldSettings, values["light_field"]),
            from_dict(ProjectionSettings, values["projection"]),
            None if values["anchor"] is None else tuple(values["anchor"]),
            values["resample"],
        )

    def open(self, stack: ExitStack) -> list[PSFMatrix]:
        """Open H from ``psf`` and H of each of ``regions``, and return them; closing ``stack`` closes the files."""
        places = [(self.psf, ""), *_places(self.psf, self.regions)]
        orders = [self.mat_order if file.suffix.lower() == ".mat" else "" for file, _ in places]
        return [
            stack.enter_context(open_psf(file, region=region, mat_order=order))
            for (file, region), order in zip(places, orders, strict=True)
        ]

    def view(self, H: PSFMatrix, shape: tuple[int, int]) -> Resampling | None:
        """Return the map that resamples frames of ``shape`` to the period of H. None: frames are used unchanged."""
        return resampling_for(H, shape, self.light_field) if self.resample else None

    def image_anchor(self, view: Resampling | None, H: PSFMatrix) -> Anchor | None:
        """Return `anchor` if it is set, else the anchor of H after resampling by ``view``.

        None if there is neither: the stored anchor of ``H`` applies.
        """
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
        """Return the projector for frames of shape ``frame`` after resampling and extension by ``margin`` on each side.

        ``matrices`` is the result of `open`, and ``view`` the resampling of the frames (None: none). If the noise of H
        is known, the projector uses H with reduced noise. A non-empty ``method`` replaces the projection method of the
        settings. ``memory`` is the memory limit in bytes; ``workers`` and ``device`` are as in `Projector`.
        """
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
    """Return the shape of an image of ``shape`` extended by ``margin`` pixels on every side."""
    return shape[0] + 2 * margin, shape[1] + 2 * margin


def files_of_regions(psf: Path, regions: Sequence[str]) -> list[Path]:
    """Return the paths in ``regions``, without ``psf`` and duplicates.

    Each entry is the name of a region in ``psf``, or the path of another H file; raise `InputError` if it is neither.
    """
    found = [Path(file) for file, _ in _places(psf, regions) if file != psf]
    return list(dict.fromkeys(found))


def _places(psf: Path, regions: Sequence[str]) -> list[tuple[Path, str]]:
    """Return file and region for each of ``regions``, which are names of regions in ``psf`` or paths of other files.

    Raises
    ------
    InputError
        If an entry is neither.
    """
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
            named = ", ".join(filter(None, own)) or "unnamed"
            raise InputError.expected(
                "--region", f"a region of {psf.name} ({named}) or an H file", name, "choose one of these"
            )
    if not found:
        raise InputError.expected(
            "--region", f"regions other than the first of {psf.name}", "none", "leave --region out"
        )
    return found
