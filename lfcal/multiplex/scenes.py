"""Synthetic scenes for testing modulators: a light field of bright filaments, and colour charts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["colour_edges", "filament_light_field", "view_edges", "zone_plate"]

Array = NDArray[np.float64]

DEPTHS = (-0.8, -0.3, 0.2, 0.7)
"""Disparities of the filaments' layers (super-pixels over the whole aperture)."""


def filament_light_field(views: int, cells: tuple[int, int], rng: np.random.Generator) -> Array:
    """Return a light field of curved filaments in four layers, sampled at every pixel ``(views^2, rows, columns)``.

    Parameters
    ----------
    views
        Number of views along a side, and side of a super-pixel (pixels).
    cells
        Number of super-pixels ``(rows, columns)``.
    rng
        Random number generator for the filaments.

    Returns
    -------
    NDArray
        Samples of the light field, whose filaments are about two super-pixels wide; the largest sample is 1/views^2.
    """
    from lfcal.base import cv2

    shape = (cells[0] * views, cells[1] * views)
    field = np.zeros((views, views, *shape), np.float32)
    for disparity in DEPTHS:
        layer = _filaments(shape, 1.1 * views, rng)
        step = disparity * views / max(1, views - 1)
        for v in range(views):
            for u in range(views):
                move = np.array([[1, 0, step * (u - (views - 1) / 2)], [0, 1, step * (v - (views - 1) / 2)]])
                field[v, u] += cv2.warpAffine(
                    layer, move, shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
                )
    field += 0.05 * field.max()
    return np.asarray(field.reshape(views * views, *shape) / (field.max() * views * views), float)


def _filaments(shape: tuple[int, int], width: float, rng: np.random.Generator) -> NDArray[np.float32]:
    from lfcal.base import cv2

    image = np.zeros(shape, np.float32)
    for _ in range(6):
        # a smooth random walk across the frame
        steps = 200
        heading = rng.uniform(0, 2 * math.pi) + np.cumsum(rng.normal(0, 0.05, steps))
        length = 1.6 * max(shape) / steps
        path = rng.uniform(0, 1, 2) * shape[::-1] + length * np.cumsum(
            np.stack([np.cos(heading), np.sin(heading)], 1), 0
        )
        points = np.rint(path * 16).astype(np.int32).reshape(-1, 1, 2)
        thickness = max(1, round(0.6 * width))
        cv2.polylines(image, [points], False, float(rng.uniform(0.5, 1)), thickness, cv2.LINE_AA, 4)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8 * width), np.float32)


def zone_plate(shape: tuple[int, int], highest: float = 0.5) -> Array:
    """Return red, green and blue ``(3, rows, columns)`` of a zone plate in 0 … 1, with a phase shift between colours.

    The frequency increases from zero in the middle to ``highest`` cycles per pixel at the nearer edges.
    """
    y, x = np.ogrid[: shape[0], : shape[1]]
    r2 = (y - (shape[0] - 1) / 2) ** 2 + (x - (shape[1] - 1) / 2) ** 2
    phase = 2 * math.pi * highest * r2 / min(shape)
    return np.stack([0.5 + 0.4 * np.cos(phase + 0.7 * k) for k in range(3)])


def colour_edges(shape: tuple[int, int]) -> Array:
    """Return red, green and blue ``(3, rows, columns)`` in 0 … 1: uniform patches with sharp, slanted borders."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    h, w = shape
    image = np.zeros((3, *shape)) + np.array([0.25, 0.3, 0.35])[:, None, None]
    disc = (y - 0.5 * h) ** 2 + (x - 0.3 * w) ** 2 < (0.2 * min(h, w)) ** 2
    bar = np.abs((x - 0.68 * w) + 0.2 * (y - 0.5 * h)) < 0.09 * w
    low = (y > 0.8 * h) & (x > 0.1 * w) & (x < 0.55 * w)
    for mask, colour in ((disc, (0.9, 0.75, 0.15)), (bar, (0.2, 0.8, 0.9)), (low, (0.9, 0.2, 0.3))):
        image[:, np.broadcast_to(mask, shape)] = np.array(colour)[:, None]
    return np.asarray(image)


def view_edges(views: int, cells: tuple[int, int]) -> Array:
    """Return a light field ``(views^2, rows, columns)`` of sharp-edged patches, brighter towards the middle view.

    ``views`` is the number of views along a side and the side of a super-pixel (px), and ``cells`` the number of
    super-pixels (rows, columns).
    """
    shape = (cells[0] * views, cells[1] * views)
    chart = colour_edges(shape).mean(0)
    offset = np.linspace(-1, 1, views) if views > 1 else np.zeros(1)
    weight = np.exp(-0.5 * (offset[:, None] ** 2 + offset**2)).ravel()
    return np.asarray(weight[:, None, None] * chart / (views * views))
