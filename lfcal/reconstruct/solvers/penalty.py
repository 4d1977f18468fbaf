"""Penalties that prevent a reconstruction from fitting noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["Penalty", "Tikhonov", "TotalVariation"]


SLAB = 4
"""Number of planes whose gradient is computed at a time if differences between planes count."""


class Penalty(Protocol):
    """Protocol for a penalty on the roughness of a volume; a penalty is defined by its gradient."""

    def gradient(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return the weighted derivative of the penalty with respect to each voxel of ``volume`` ``(nz, Y, X)``.

        It is dimensionless, relative to the sensitivity HT1.
        """
        ...


@dataclass(frozen=True, slots=True)
class TotalVariation:
    """Total-variation penalty (Dey et al. 2006, equation 9), which reduces noise and preserves edges.

    Attributes
    ----------
    weight
        Strength of the penalty relative to the sensitivity HT1 (the back projection of ones): 0.002 is weak, 0.05 is
        strong.
    z_weight
        Weight of differences between planes relative to those within a plane; 0: planes are independent.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import TotalVariation
    >>> edges = np.array([[[0.0, 0.0, 1.0, 1.0, 4.0, 4.0]]])  # a high edge is pulled down no more than a low one
    >>> print((TotalVariation(weight=1.0).gradient(edges)[0, 0].round(3) + 0).tolist())
    [0.0, -1.0, 1.0, -1.0, 1.0, 0.0]
    """

    weight: float = 0.002
    z_weight: float = 0.0

    def __post_init__(self) -> None:
        """Check both weights."""
        _check(self.weight, self.z_weight)

    def gradient(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return minus `weight` times the divergence of the normalised gradient of ``volume`` ``(nz, Y, X)``."""
        # below a millionth of the peak, the direction of the gradient is only rounding.
        least = max(float(volume.max(initial=0.0)) * 1e-6, float(np.finfo(volume.dtype).tiny))

        def of(slab: NDArray[Any]) -> NDArray[Any]:
            steps = _differences(slab, self.z_weight)
            size = np.sqrt(sum(d * d for d in steps.values()))
            size += least
            for axis, step in steps.items():
                step /= size
                if axis == 0:
                    step *= volume.dtype.type(self.z_weight)
            return _scaled(_divergence(steps), -self.weight)

        return _by_slabs(volume, of, self.z_weight)


@dataclass(frozen=True, slots=True)
class Tikhonov:
    """Tikhonov-Miller penalty on the squared gradient, which reduces noise and softens edges.

    Attributes
    ----------
    weight
        Strength of the penalty relative to the sensitivity HT1 and to the volume's peak: 0.02 is weak; values above 0.2
        are unstable.
    z_weight
        Weight of differences between planes relative to those within a plane; 0: planes are independent.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Tikhonov
    >>> edges = np.array([[[0.0, 0.0, 1.0, 1.0, 4.0, 4.0]]])  # a high edge is pulled down more than a low one
    >>> print((Tikhonov(weight=1.0).gradient(edges)[0, 0] + 0).tolist())
    [0.0, -0.25, 0.25, -0.75, 0.75, 0.0]
    """

    weight: float = 0.02
    z_weight: float = 0.0

    def __post_init__(self) -> None:
        """Check both weights."""
        _check(self.weight, self.z_weight)

    def gradient(self, volume: NDArray[Any]) -> NDArray[Any]:
        """Return minus `weight` times the Laplacian of ``volume`` ``(nz, Y, X)``, divided by the peak of the volume."""
        # divided by the peak, so that the weight has the same effect in any unit of light
        peak = float(volume.max(initial=0))

        def of(slab: NDArray[Any]) -> NDArray[Any]:
            steps = _differences(slab, self.z_weight)
            if 0 in steps:
                # z_weight enters twice, in the difference and in its adjoint: the gradient of a weighted norm
                steps[0] *= volume.dtype.type(self.z_weight)
            return _scaled(_divergence(steps), -self.weight / peak if peak > 0 else 0.0)

        return _by_slabs(volume, of, self.z_weight)


def _check(weight: float, z_weight: float) -> None:
    if not (0 <= weight < 10 and 0 <= z_weight < 100):
        raise InputError.expected(
            "penalty weights", "small numbers of 0 or more", (weight, z_weight), "try 0.002 and 0"
        )


def _by_slabs(volume: NDArray[Any], of: Callable[[NDArray[Any]], NDArray[Any]], z_weight: float) -> NDArray[Any]:
    """Return the result of ``of`` for a volume, computed for a few planes at a time to save memory.

    Each plane needs only its neighbours, or no other plane if planes are not compared.
    """
    out = np.empty_like(volume)
    beside, step = (1, SLAB) if z_weight > 0 else (0, 1)
    for z in range(0, len(volume), step):
        first, stop = max(0, z - beside), min(len(volume), z + step)
        out[z:stop] = of(volume[first : stop + beside])[z - first : stop - first]
    return out


def _differences(volume: NDArray[Any], z_weight: float) -> dict[int, NDArray[Any]]:
    """Return forward differences along the axes in use, zero at the far border."""
    axes = (0, 1, 2) if z_weight > 0 and len(volume) > 1 else (1, 2)
    steps = {}
    for axis in axes:
        step = np.zeros_like(volume)
        # the far border has no forward neighbour: its difference is zero (Neumann border)
        inner = tuple(slice(0, -1) if a == axis else slice(None) for a in range(3))
        step[inner] = np.diff(volume, axis=axis)
        if axis == 0:
            step *= volume.dtype.type(z_weight)
        steps[axis] = step
    return steps


def _divergence(steps: dict[int, NDArray[Any]]) -> NDArray[Any]:
    """Return the negative adjoint of `_differences`."""
    total = np.zeros_like(next(iter(steps.values())))
    for axis, step in steps.items():
        total += step
        later = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        earlier = tuple(slice(0, -1) if a == axis else slice(None) for a in range(3))
        total[later] -= step[earlier]
    return total


def _scaled(array: NDArray[Any], factor: float) -> NDArray[Any]:
    array *= array.dtype.type(factor)
    return array
