"""H of several regions of the field, as ``lfcal reconstruct --region`` names them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from contextlib import ExitStack

    from lfcal.psf import PSFMatrix
    from lfcal.reconstruct import Projector

__all__ = ["ALL", "files_of_regions", "open_regions", "projector_of"]

ALL = "all"
"""Every region that the H file has."""


def files_of_regions(psf: Path, regions: Sequence[str]) -> list[Path]:
    """Return the H files that ``--region`` names beside ``psf``, each once."""
    found = [Path(file) for file, _ in _places(psf, regions) if file != psf]
    return list(dict.fromkeys(found))


def _places(psf: Path, regions: Sequence[str]) -> list[tuple[Path, str]]:
    """Return file and region of each ``--region``: a region of ``psf`` by its name, or another file.

    Raises
    ------
    InputError
        If it is neither.
    """
    from lfcal.base import InputError
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


def open_regions(
    psf: Path, regions: Sequence[str], stack: ExitStack, *, mat_order: str = "", quiet: bool = False
) -> list[PSFMatrix]:
    """Return H of ``psf`` and of each of ``regions``, which ``stack`` closes."""
    from lfcal.tasks import open_matrix

    places = [(psf, ""), *_places(psf, regions)]
    return [
        stack.enter_context(open_matrix(file, region=region, mat_order=mat_order, quiet=quiet))
        for file, region in places
    ]


def projector_of(
    matrices: Sequence[PSFMatrix],
    shape: tuple[int, int],
    anchor: tuple[float, float] | None,
    method: str,
    **settings: Any,
) -> Projector:
    """Return the projector of one H, or that of several regions of the field, with less noise where it is known."""
    from lfcal.reconstruct import FieldProjector, Projector

    if len(matrices) == 1:
        return Projector(matrices[0], shape, anchor, method, **settings).denoised()
    return FieldProjector(matrices, shape, anchor, method, **settings).denoised()
