"""Result of a fit with its uncertainty, and the corresponding model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Position, Work, drained, plain
from lfcal.camera import Camera, ScanPlan
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.hybrid import HybridPlanes
from lfcal.fit.measured import Measured
from lfcal.fit.model import ModelPlanes
from lfcal.fit.model_error import INCOMPLETE, ChiSquare, ModelError
from lfcal.fit.nuisance import Spread
from lfcal.fit.setup import Setup
from lfcal.psf import Header, PSFMatrix, iter_make
from lfcal.simulate.effects import Effect

__all__ = ["Fit", "InRegion", "Outlier", "Parameter"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One fitted parameter.

    Attributes
    ----------
    name, group, unit
        As in `lfcal.fit.parameters.Unknown`.
    value, sigma
        Fitted value and its standard deviation, in ``unit``. The standard deviation includes the uncertainty of
        degenerate parameters that were tried but are fixed at the values in the description.
    start
        Start value, from the description of the camera.
    sigma_held
        Standard deviation of the value if all parameters that were not fitted have exactly their described values; use
        it to compare fits of the same groups.

    Examples
    --------
    >>> from lfcal.fit import Parameter
    >>> gap = Parameter("gap_um", "geometry", "um", value=290.4, sigma=0.1, start=290.0, sigma_held=0.05)
    >>> print(f"{(gap.value - gap.start) / gap.sigma:.0f} standard deviations from the description")
    4 standard deviations from the description
    """

    name: str
    group: str
    unit: str
    value: float
    sigma: float
    start: float
    sigma_held: float


@dataclass(frozen=True, slots=True)
class Outlier:
    """A pattern that was excluded from the fit because it differs from the others.

    ``z``, ``y`` and ``x`` are the indices of its position, and ``region`` is the index of its region of the field.
    ``reason`` describes the difference.

    Examples
    --------
    >>> from lfcal.fit import Outlier
    >>> lost = Outlier(0, 4, 7, "no light")
    >>> print(f"({lost.z}, {lost.y}, {lost.x}): {lost.reason}")
    (0, 4, 7): no light
    """

    z: int
    y: int
    x: int
    reason: str
    region: int = 0


@dataclass(frozen=True, slots=True)
class InRegion:
    """Chi-square and error of the patterns of one region, for a joint fit of several regions."""

    chi_square: ChiSquare
    error: ModelError


@dataclass(frozen=True, eq=False)
class Fit:
    """A camera retrieved from measured patterns.

    Attributes
    ----------
    setup
        Fitted camera, effects, depths and stage errors.
    planned
        The scan as planned, with the camera from which the fit started.
    parameters
        Fitted parameters, by name.
    groups, unhelpful
        Names of the groups of unknowns that were fitted, and of those that were tried but did not improve the
        prediction of held-out patterns.
    chi_square
        Chi-square of the fitted patterns.
    held_out_error
        Relative error (L2) of the predicted patterns, estimated from held-out patterns, or from fitted ones if none was
        held out. If the model is incomplete, it is estimated from all patterns.
    correlations
        Correlation matrix ``(k, k)`` of the parameters, in the order of ``parameters``.
    held
        Descriptions of the quantities that were fixed to make the parameters unique.
    unidentified
        Combinations of parameters that this scan does not determine, and degeneracies with parameters that were tried
        but stay fixed. Fitting these as well would greatly increase the uncertainties.
    outliers
        Patterns that were excluded, with the reason.
    answers
        Answers to discrete questions, by question, where they differ from the description.
    spread
        Rms scatter of the source positions (px), and of the lamp's brightness and the pixel response (fractions).
    residuals
        Measured minus predicted values ``(nt, ns)`` in standard deviations of the noise, by position (z, y, x).
    levels
        Gain (counts per unit of the model) and background (counts) of each plane; for planes without a pattern, the
        gain is interpolated.
    here
        For a fit of several regions of the field, the quality in this region; otherwise None.
    """

    setup: Setup
    planned: ScanPlan
    parameters: Mapping[str, Parameter]
    groups: tuple[str, ...]
    unhelpful: tuple[str, ...]
    chi_square: ChiSquare
    held_out_error: ModelError
    correlations: NDArray[np.float64]
    held: tuple[str, ...]
    unidentified: tuple[str, ...]
    outliers: tuple[Outlier, ...]
    answers: Mapping[str, str]
    spread: Spread
    levels: PatternLevels = field(repr=False)
    residuals: Mapping[tuple[int, int, int], NDArray[np.float32]] = field(repr=False)
    here: InRegion | None = None

    @property
    def camera(self) -> Camera:
        """The fitted camera."""
        return self.setup.camera

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The fitted effects."""
        return self.setup.effects

    @property
    def chi2(self) -> float:
        """Mean of the squared residuals divided by their variance, weighted by light; about 1 for a correct model."""
        return self.chi_square.lit

    @property
    def complete(self) -> bool:
        """Whether the model is complete, that is, whether chi² exceeds 1 by less than five standard deviations."""
        return self.chi_square.complete

    @property
    def verdict(self) -> str:
        """Line of text on the reliability of the fit."""
        error = f"error of the model {self.held_out_error}"
        if not math.isfinite(self.chi_square.sigma):
            return f"chi² unknown: the samples do not outnumber the unknowns; {error}"
        if self.chi_square.excess < -INCOMPLETE:
            less = f"{-self.chi_square.excess:.0f} sigma below 1: the noise is smaller than stated"
            return f"chi² {self.chi2:.3f}, {less}; {error}"
        if self.complete:
            return f"chi² {self.chi2:.3f}; {error}"
        more = f"chi² {self.chi2:.3f}, {self.chi_square.excess:.0f} sigma above 1"
        return f"model incomplete: {more}; {error}; more patterns do not help"

    def residual(self, z: int, y: int, x: int) -> NDArray[np.float32]:
        """Return the measured minus the predicted pattern ``(nt, ns)`` at position (z, y, x).

        The unit is the standard deviation of the noise.

        Raises
        ------
        InputError
            If the position was not measured, or its pattern was excluded as an outlier.
        """
        if (z, y, x) not in self.residuals:
            where = Position(z, y, x)
            raise InputError.expected("residual", "a measured position", tuple(where), "choose a recorded position")
        return self.residuals[z, y, x]

    @property
    def header(self) -> Header:
        """Header of the H of the fitted camera: shape, depths, camera, anchor and provenance, without its values."""
        plan = self.planned
        return Header(plan.shape, plan.depths_um, self.camera, plan.anchor, self.provenance)

    def planes(self, header: Header | None = None) -> ModelPlanes:
        """Return an object that computes the planes of the H of the fitted camera.

        ``header`` is the header of this H. None: `Fit.header`.
        """
        return ModelPlanes(header or self.header, self.ideal_places, self.planned, self.levels.gains.tolist())

    def iter_model(self, workers: int | None = None) -> Work[PSFMatrix]:
        """Return the H of the fitted camera for all positions and depths, without noise, in counts.

        ``workers`` is the number of threads. None: all processors.

        Yields
        ------
        Progress
            Finished and total number of rows of positions.
        """
        return (yield from iter_make(self.planes(), workers=workers))

    model = drained(iter_model)

    @property
    def unseen(self) -> tuple[int, ...]:
        """Indices of the planes without a pattern other than outliers; the gain of these planes was not measured."""
        return tuple(sorted(set(range(self.planned.shape[0])) - {z for z, _, _ in self.residuals}))

    @property
    def unseen_words(self) -> str:
        """Line of text on how H was determined in planes without a pattern; empty if there are no such planes."""
        if not self.unseen:
            return ""
        planes = ", ".join(map(str, self.unseen))
        if len(self.unseen) == 1:
            return (
                f"plane {planes}: no pattern was recorded; H is that of the model, with the gain of the "
                "neighbouring planes"
            )
        return (
            f"planes {planes}: no pattern was recorded; H is that of the model, with the gains of the "
            "neighbouring planes"
        )

    @property
    def provenance(self) -> dict[str, Any]:
        """Provenance of the H of the fitted camera, as plain JSON types."""
        fit = {"chi2": self.chi2, "error": self.held_out_error.value, "groups": list(self.groups)}
        fit |= {"depth_errors_um": list(self.setup.depth_errors_um), "patterns": len(self.residuals)}
        fit |= {"aside_px": list(self.setup.aside_px)} if any(self.setup.aside_px) else {}
        fit |= {"gains": self.levels.gains.tolist(), "planes_without_patterns": list(self.unseen)}
        effects = [{"name": one.name, **plain(one)} for one in self.effects]
        return {"fit": fit, "effects": effects, "plan": self.setup.plan(self.planned).to_dict()}

    @property
    def middle_um(self) -> tuple[float, float]:
        """Middle (x, y) of the scanned region, relative to the centre of the sensor (µm).

        In a fit of a single region, the array is rotated and scaled about this point.
        """
        plan = self.planned
        middle = np.array(plan.anchor) + (np.array(plan.period) - 1) / 2
        y, x = (middle - np.array(plan.camera.sensor.centre_px)) * plan.camera.sensor.pixel_um
        return float(x), float(y)

    @property
    def ideal_places(self) -> Setup:
        """The fitted setup with the sources at the positions of H.

        Depths are as fitted, but lateral steps are as planned, and the stage moves along the optical axis.
        """
        return replace(self.setup, stage_scale=0.0, travel_rad=(0.0, 0.0))

    def iter_hybrid(
        self,
        source: PSFMatrix | Measured,
        *,
        noise: tuple[float, float] | None = None,
        workers: int | None = None,
    ) -> Work[PSFMatrix]:
        """Return the H of the fitted camera plus measured deviations from it, with the uncertainties of all entries.

        Parameters
        ----------
        source
            Recorded patterns of the same scan, all or only the fitted ones.
        noise
            ``(constant, slope)``: the variance of a sample of value v is ``constant + slope * max(v, 0)`` (counts²).
            None: as stated by the H. For `Measured`, which states its own noise, ``noise`` is ignored.
        workers
            Number of threads. None: all processors.

        Yields
        ------
        Progress
            Counted in rows of positions, then in tiles. Closing the generator stops the computation.

        Raises
        ------
        InputError
            If the patterns belong to another scan, their noise is unknown, or the source is a transposed H.
        """
        return (yield from iter_make(HybridPlanes(self.header, self, source, noise), workers=workers))

    hybrid = drained(iter_hybrid)
