"""Projections with an H that is drawn from the uncertainty of a fit."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.psf import PSFMatrix, open_psf
from lfcal.reconstruct.projectors import Projector

__all__ = ["DrawnH", "UncertainH"]

F4 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DrawnH:
    """An H that differs from that of a projector by steps along the axes of its uncertainty.

    Attributes
    ----------
    uncertain
        H and its uncertainty.
    steps
        Size of the step along each axis, in standard deviations.
    """

    uncertain: UncertainH
    steps: NDArray[np.float64]

    def forward(self, volume: ArrayLike) -> NDArray[np.float64]:
        """Return the image ``(Y, X)`` of ``volume`` ``(nz, Y, X)``."""
        return self.uncertain.P.forward(volume) + self.uncertain.change(volume, self.steps)


@dataclass(frozen=True, eq=False)
class UncertainH:
    """An H and its changes along the axes of its uncertainty; calling it draws a `DrawnH`.

    Attributes
    ----------
    P
        Projector of H.
    changes
        Projector of the changes, all planes of the first axis, then those of the second. Each is relative to the light
        of its plane.
    light
        Light of each plane of H, ``(nz,)``.
    """

    P: Projector
    changes: Projector
    light: NDArray[np.float64]

    @classmethod
    def of(cls, P: Projector, H: PSFMatrix, file: Path, stack: ExitStack, workers: int | None = None) -> UncertainH:
        """Open the ``file`` of the changes of H, as ``lfcal.fit.iter_write_deviations`` writes it.

        Parameters
        ----------
        P
            Projector of ``H``.
        H
            H of one region of the field.
        file
            Path of the file. It stays open until ``stack`` is closed.
        workers
            Number of threads. None: all processors.

        Raises
        ------
        InputError
            If the file does not describe changes of this H.
        """
        found = stack.enter_context(open_psf(file))
        if found.shape[0] % H.shape[0] or found.shape[1:] != H.shape[1:]:
            got = f"planes {found.shape}, and H {H.shape}"
            raise InputError.expected(str(file), "changes of all planes of this H", got, "compute the file again")
        light = np.array([H.depth_sum(z).sum() for z in range(H.shape[0])])
        # needed once for each volume, while H is needed in every iteration
        room = max(0, P.memory_limit - P.forecast().chosen.memory_bytes)
        at = P.grid.anchor
        changes = Projector(found, P.image_shape, at, dtype=P.dtype, memory_limit=room, workers=workers)
        return cls(P, changes, light)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.changes.volume_shape[0] // len(self.light)

    def change(self, volume: ArrayLike, steps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the change ``(Y, X)`` of the image of ``volume``; ``steps`` ``(axes,)`` are in standard deviations."""
        data, nz = np.asarray(volume, np.float32), len(self.light)
        planes = (
            (k * nz + z, np.float32(step * light) * data[z])
            for k, step in enumerate(steps)
            for z, light in enumerate(self.light)
        )
        return np.asarray(self.changes.forward_planes(planes), np.float64)

    def modes(self, volume: ArrayLike) -> NDArray[np.float64]:
        """Return the change of the image of ``volume`` for one standard deviation along each axis, ``(axes, Y, X)``."""
        return np.array([self.change(volume, one) for one in np.eye(self.axes)])

    def __call__(self, rng: np.random.Generator) -> DrawnH:
        """Draw an H."""
        return DrawnH(self, rng.standard_normal(self.axes))
