"""Sensor nodes: the light on a pixel from intensities at a few points.

The intensity behind an aperture of radius r is band-limited to 2 r / (lambda B). Evenly spaced nodes with non-negative
weights, which extend slightly into neighbouring pixels, are fitted to the pixel's transfer function over that band.
They integrate it with fewer points than Gauss-Legendre nodes inside the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

__all__ = ["MANY_ANGLES", "ONE_APERTURE", "NodeRule", "WindowNodes", "conserving", "fitted_rule"]

ONE_APERTURE, MANY_ANGLES = 1.5, 3.0
"""Power with which the spectrum of light falls to zero: behind one round aperture, and behind many."""


MIN_WEIGHT = 0.1
"""Fraction of the largest node weight below which a node counts as left out."""

EVEN = 0.01
"""Strength with which weights are then evened out; the fit stays accurate to 2e-4."""


@dataclass(frozen=True, slots=True)
class NodeRule:
    """Evenly spaced nodes, ``per_px`` per pixel, whose ``weights`` give one pixel.

    ``weights`` has ``per_px + 2 beyond`` entries: ``beyond`` nodes on either side are in the neighbours.
    """

    per_px: int
    beyond: int
    weights: NDArray[np.float64]

    def count(self, width_px: int) -> int:
        """Return the number of nodes along an axis for a window of ``width_px`` pixels."""
        return width_px * self.per_px + 2 * self.beyond

    def positions(self, width_px: int) -> NDArray[np.float64]:
        """Return the nodes of a window about 0, in pixels."""
        n = self.count(width_px)
        return (np.arange(n) - (n - 1) / 2) / self.per_px

    def matrix(self, width_px: int) -> NDArray[np.float64]:
        """Return the matrix ``(nodes, pixels)`` from intensities to pixel values along one axis."""
        m = np.zeros((self.count(width_px), width_px))
        for p in range(width_px):
            m[p * self.per_px : p * self.per_px + self.weights.size, p] = self.weights
        return m


@dataclass(frozen=True, slots=True)
class WindowNodes:
    """Nodes of a window along an axis, with fewer nodes per pixel away from its middle.

    Attributes
    ----------
    positions
        Positions of the nodes about the middle of the window, in pixels.
    runs, weights
        Runs of neighbouring pixels whose nodes are neighbours too ``(runs, 3)``, as first node, first pixel and number;
        and the weight of the nodes of each run.
    """

    positions: NDArray[np.float64]
    runs: NDArray[np.int64]
    weights: NDArray[np.float32]

    @classmethod
    def of(cls, fine: NodeRule, coarse: NodeRule, pixels: int, middle: int) -> WindowNodes:
        """Return the nodes of ``pixels``: those of ``fine`` for ``middle`` of them, else those of ``coarse``."""
        middle = min(pixels, middle + (pixels - middle) % 2)
        side = (pixels - middle) // 2
        positions, runs, weights = [np.zeros(0)], [], []
        start = 0
        for rule, first, width in ((coarse, 0, side), (fine, side, middle), (coarse, side + middle, side)):
            if width == 0:
                continue
            at = rule.positions(width) + first + (width - pixels) / 2
            taps = []
            for phase in range(rule.per_px):  # nodes with the same place in their pixel are neighbours
                taps.append(start)
                positions.append(at[phase :: rule.per_px])
                start += positions[-1].size
            for j, weight in enumerate(rule.weights):
                runs.append((taps[j % rule.per_px] + j // rule.per_px, first, width))
                weights.append(weight)
        return cls(np.concatenate(positions), np.array(runs), np.array(weights, np.float32))

    def pixels(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the pixels that each node belongs to ``(nodes, most)``, -1 for none, and its weights there."""
        found: list[list[tuple[int, float]]] = [[] for _ in self.positions]
        for (node, pixel, count), weight in zip(self.runs.tolist(), self.weights.tolist(), strict=True):
            for i in range(count):
                found[node + i].append((pixel + i, weight))
        most = max(len(each) for each in found)
        filled = [[*each, *[(-1, 0.0)] * (most - len(each))] for each in found]
        return (
            np.array([[pixel for pixel, _ in each] for each in filled]),
            np.array([[weight for _, weight in each] for each in filled], np.float32),
        )


def fitted_rule(
    per_px: int,
    band: float,
    fill: float = 1.0,
    beyond: int = 1,
    falloff: float = ONE_APERTURE,
    even: float = 0.0,
) -> NodeRule:
    """Return the rule for intensities band-limited to ``band`` cycles per pixel.

    The weights solve a non-negative least-squares fit of sum_k w_k cos(2 pi f x_k) to sinc(f fill) fill. The fit is
    weighted by the transfer function 1 - f/band of the light, and its sum is constrained to ``fill``.

    Parameters
    ----------
    per_px
        Number of nodes per pixel.
    band
        Highest frequency of the intensity (cycles per pixel), 2 r pixel / (lambda B).
    fill
        Light-sensitive fraction of the pixel's side.
    beyond
        Number of nodes in each neighbour; more than one has no benefit.
    falloff
        Power of 1 - f/band with which the light's spectrum falls to zero: `ONE_APERTURE` or `MANY_ANGLES`.
    even
        Strength of the pull towards equal weights. Without it, some nodes are unused if the light needs fewer nodes.
    """
    n = per_px + 2 * beyond
    x = (np.arange(n) - (n - 1) / 2) / per_px
    f = np.linspace(0.0, band, 400)
    # the added constant keeps the end of the band in the fit
    trust = np.clip(1 - f / band, 0.0, None) ** falloff + 1e-3
    trust[0] = 1e3
    right = x[n // 2 :]  # the weights are symmetric
    basis = np.cos(2 * np.pi * np.outer(f, right)) * np.where(right == 0, 1.0, 2.0)
    wanted = fill * np.sinc(f * fill) * trust
    basis *= trust[:, None]
    if even:
        basis = np.concatenate([basis, even * np.eye(right.size)])
        wanted = np.concatenate([wanted, np.where(right < 0.5, even * fill / per_px, 0.0)])
    solution, _ = nnls(basis, wanted)
    weights = np.concatenate([solution[n % 2 :][::-1], solution])
    return NodeRule(per_px, beyond, weights * (fill / weights.sum()))


def conserving_rule(per_px: int, band: float, falloff: float = ONE_APERTURE) -> NodeRule:
    """Return the rule for pixels without gaps, with weights made by `conserving`; see `fitted_rule`.

    If the light needs far fewer nodes, the best fit leaves some out, but all pixels together must use every node.
    """
    rule = fitted_rule(per_px, band, falloff=falloff)
    taken = [float(rule.weights[first::per_px].sum()) for first in range(per_px)]
    if min(taken) < MIN_WEIGHT * max(taken):
        rule = fitted_rule(per_px, band, falloff=falloff, even=EVEN)
    return conserving(rule)


def conserving(rule: NodeRule) -> NodeRule:
    """Return the rule with weights that conserve light: all pixels together weigh all nodes equally."""
    weights = rule.weights.copy()
    for first in range(rule.per_px):
        weights[first :: rule.per_px] *= rule.weights.sum() / (rule.per_px * weights[first :: rule.per_px].sum())
    return NodeRule(rule.per_px, rule.beyond, weights)
