"""How files of other codes are opened, as the user stated it: kept in the project, file by file. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lfcal.base import InputError
from lfcal.psf import check_mat_order
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.settings import PageSettings


@dataclass(frozen=True)
class OpeningSettings(PageSettings):
    """What files do not say of themselves.

    Attributes
    ----------
    mat_orders
        Pairs of a .mat file and the order of the axes of its H, as ``mat_order`` of `lfcal.psf.open_psf`.
    """

    page: ClassVar[str] = "opening"

    mat_orders: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check every pair."""
        for pair in self.mat_orders:
            if not isinstance(pair, tuple) or len(pair) != 2 or not all(isinstance(part, str) for part in pair):
                raise InputError.expected("mat_orders", "pairs of file and order", repr(pair), "correct it")
            check_mat_order(pair[1])

    def with_order(self, path: str, order: str) -> OpeningSettings:
        """Return the settings by which the file ``path`` is read in ``order``."""
        others = tuple(pair for pair in self.mat_orders if pair[0] != path)
        return OpeningSettings((*others, (path, order)))


def stated_order(project: ProjectState, path: str) -> str:
    """Return the order of the axes of H that the user stated for a .mat file; empty: none."""
    return dict(OpeningSettings.of(project).mat_orders).get(path, "")
