"""Plots of a fit: patterns next to their model, residuals by position and lens type, parameters."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import COLOURS, LINES, draw_image, figure, save_figure
from lfcal.camera import Camera, PupilLenslets, ScanPlan
from lfcal.fit._weighing import BEND
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.result import Fit

__all__ = ["FitResiduals", "draw_leftover", "draw_parameters", "draw_patterns", "leftover_of"]

F4 = NDArray[np.float32]

SHOWN = 4
"""Number of patterns drawn next to their model."""


@dataclass(frozen=True, eq=False)
class FitResiduals:
    """Residuals of the patterns of a fit.

    Attributes
    ----------
    index
        Positions ``(n, 3)`` as (z, y, x).
    measured, model, residual
        Patterns ``(n, nt, ns)``: as recorded; as predicted, with gain and background, for sources at their planned
        positions; and residuals in standard deviations, for sources at their fitted positions.
    chi2
        Mean Huber loss of the residuals of each pattern ``(n,)``, weighted by the light; the loss of a small residual
        is its square.
    by_plane
        Mean loss as in ``chi2``, for each plane ``(nz,)``; NaN without a measurement.
    by_type
        Mean loss as in ``chi2``, for the pixels behind each lens type or, in a Fourier light-field microscope, behind
        each lenslet, ``(types,)``.
    maps
        Mean square of the residuals over the patterns of each plane ``(nz, nt, ns)``; NaN without a measurement.
    type_name
        Name of one category of ``by_type``: "lens type" or "lenslet".
    """

    index: NDArray[np.intp]
    measured: F4
    model: F4
    residual: F4
    chi2: NDArray[np.float64]
    by_plane: NDArray[np.float64]
    by_type: NDArray[np.float64]
    maps: NDArray[np.float64]
    type_name: str


def leftover_of(fit: Fit, measured: Measured) -> FitResiduals:
    """Return the residuals of the patterns of ``fit``, including held-out ones but not outliers.

    ``measured`` are the patterns from which the fit was computed.
    """
    index = np.array(list(fit.residuals), np.intp).reshape(-1, 3)
    rows = {tuple(at): k for k, at in enumerate(measured.index.tolist())}
    own = np.array([rows[tuple(at)] for at in index.tolist()], np.intp)
    z = index[:, 0]
    # sources at their planned positions, because displacements are not part of the camera
    light = predict(fit.setup, measured.plan, index, np.zeros((len(index), 2)), Fineness.finest)
    light *= fit.levels.factors(z)[:, None, None].astype(np.float32)
    residual = np.stack(list(fit.residuals.values()))
    constant, slope = (measured.noise[own, k, None, None] for k in (0, 1))
    bright = slope * np.maximum(light, 0)
    # pixels that are not valid, or outside the elemental images of a Fourier microscope, have no residual
    weight = np.where(measured.valid[own] & (residual != 0), bright / (constant + bright + 1e-300), 0.0)
    size = np.abs(residual, dtype=np.float64)
    loss = weight * np.where(size <= BEND, size * size, BEND * (2 * size - BEND))
    types = np.stack([lens_types(fit.camera, measured.plan, int(y), int(x)) for _, y, x in index.tolist()])
    lattice, planes = fit.camera.lattice, range(measured.plan.shape[0])
    kinds = range(len(lattice.lens_centres_um if isinstance(lattice, PupilLenslets) else lattice.types))
    empty = np.full(residual.shape[1:], np.nan)
    return FitResiduals(
        index,
        measured.patterns[own],
        (light + fit.levels.backgrounds[z, None, None]).astype(np.float32),
        residual,
        _ratio(loss.sum((1, 2)), weight.sum((1, 2))),
        np.array([float(_ratio(loss[z == k].sum(), weight[z == k].sum())) for k in planes]),
        np.array([float(_ratio(loss[types == k].sum(), weight[types == k].sum())) for k in kinds]),
        np.stack([np.square(residual[z == k], dtype=np.float64).mean(0) if (z == k).any() else empty for k in planes]),
        "lens type" if fit.camera.has_lattice else "lenslet",
    )


def _ratio(above: NDArray[np.float64], below: NDArray[np.float64]) -> NDArray[np.float64]:
    found: NDArray[np.float64] = np.where(below > 0, above / np.where(below > 0, below, 1.0), np.nan)
    return found


def lens_types(camera: Camera, plan: ScanPlan, y: int, x: int) -> NDArray[np.intp]:
    """Return the type of the lenslet in front of each pixel ``(nt, ns)`` of the pattern of source position (y, x).

    ``camera`` is the fitted camera; ``plan`` is the scan with the camera before the fit.

    In a Fourier light-field microscope, the index of the lenslet whose image is nearest to the pixel is returned
    instead.
    """
    nt, ns = plan.cutout
    rows = round(plan.anchor[0] + y) + np.arange(nt) - (nt - 1) // 2
    columns = round(plan.anchor[1] + x) + np.arange(ns) - (ns - 1) // 2
    points = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1))
    if isinstance(camera.lattice, PupilLenslets):
        # the images are about the source's position, as the lenslets are about the axis
        centres = np.array(camera.lattice.lens_centres_um) + camera.sensor_um((plan.anchor[0] + y, plan.anchor[1] + x))
        away: NDArray[np.float64] = np.square(points[..., None, :] - centres).sum(-1)
        nearest: NDArray[np.intp] = away.argmin(-1)
        return nearest
    return camera.lattice.type_at(points)


def draw_patterns(left: FitResiduals, path: str | os.PathLike[str]) -> None:
    """Draw measurement, model and residual of up to four patterns, from the best-fitting to the worst-fitting."""
    order = np.argsort(np.nan_to_num(left.chi2))
    chosen = order[np.unique(np.linspace(0, len(order) - 1, SHOWN).round().astype(int))]
    rows = len(chosen)
    with figure(9.6, 2.7 * rows) as fig:
        # a layout that measures every label of a dozen panels would take as long as the fit
        fig.set_layout_engine(None)
        fig.subplots_adjust(0.06, 0.17 / rows, 0.96, 1 - 0.1 / rows, wspace=0.2, hspace=0.32)
        for row, (panels, k) in enumerate(zip(fig.subplots(rows, 3, squeeze=False), chosen, strict=True)):
            at = tuple(int(v) for v in left.index[k])
            below = "column s (px)" if row == rows - 1 else ""
            for panel, image, title in (
                (panels[0], left.measured[k], f"measured, (z, y, x) = {at}"),
                (panels[1], left.model[k], "model"),
                (panels[2], left.residual[k], f"residual, χ² {left.chi2[k]:.2f}"),
            ):
                signed, beside = panel is panels[2], "row t (px)" if panel is panels[0] else ""
                draw_image(
                    panel, image, title=title, unit="σ" if signed else "", xlabel=below, ylabel=beside, signed=signed
                )
                panel.locator_params(nbins=4)
        save_figure(fig, path)


def draw_leftover(left: FitResiduals, path: str | os.PathLike[str]) -> None:
    """Draw mean squared residuals over the cutout in up to three planes, and chi² by position, plane and lens type."""
    shown = [z for z in range(len(left.maps)) if np.isfinite(left.maps[z]).any()]
    few = [shown[k] for k in np.unique(np.linspace(0, len(shown) - 1, min(3, len(shown))).round().astype(int))]
    with figure(9.6, 6.0) as fig:
        grid = fig.add_gridspec(2, 1)
        above, below = fig.add_subfigure(grid[0, 0]), fig.add_subfigure(grid[1, 0])
        for panel, z in zip(np.ravel(above.subplots(1, len(few))), few, strict=True):
            draw_image(panel, left.maps[z], title=f"plane {z}: mean square residual", unit="σ²")
        places, planes, types = below.subplots(1, 3)
        dots = places.scatter(left.index[:, 2], left.index[:, 1], c=left.chi2, s=22)
        places.invert_yaxis()
        places.set(title="χ² of each position", xlabel="source x (px)", ylabel="source y (px)")
        fig.colorbar(dots, ax=places, shrink=0.85)
        for panel, values, name in ((planes, left.by_plane, "depth plane"), (types, left.by_type, left.type_name)):
            panel.bar(np.arange(len(values)), np.nan_to_num(values), color=LINES[0], width=0.6)
            panel.axhline(1.0, color=COLOURS["muted"], linewidth=0.8)
            panel.set(title=f"χ² by {name}", xlabel=name)
            panel.xaxis.get_major_locator().set_params(integer=True)
        save_figure(fig, path)


def draw_parameters(fit: Fit, path: str | os.PathLike[str]) -> None:
    """Draw the deviation of every parameter from the camera description, in standard deviations of the parameter."""
    found = list(fit.parameters.values())
    off = [(one.value - one.start) / one.sigma if one.sigma > 0 else 0.0 for one in found]
    with figure(7.0, 1.2 + 0.24 * len(found)) as fig:
        panel = fig.subplots()
        panel.errorbar(off, np.arange(len(found)), xerr=1.0, fmt="o", color=LINES[0], markersize=4, capsize=2)
        panel.set_yticks(np.arange(len(found)), [one.name for one in found])
        panel.invert_yaxis()
        panel.axvline(0.0, color=COLOURS["muted"], linewidth=0.8)
        panel.set_xscale("symlog", linthresh=5.0)
        panel.set_xlabel("measured minus described (standard deviations)")
        save_figure(fig, path)
