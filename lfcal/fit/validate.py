"""Prediction of recorded points that were not fitted: the error of each, and its growth towards the field's edges."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LINES, Clock, InputError, Work, drained, figure, format_pixels, save_figure, write_text
from lfcal.fit.compared import Compared, compared_with
from lfcal.fit.files import REPORT, json_text
from lfcal.fit.locate import LocatedPattern, NewFrame
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, PlaneModel
from lfcal.fit.model_error import ModelError
from lfcal.fit.report import add_picture
from lfcal.fit.result import Fit
from lfcal.fit.stored import StoredFit

__all__ = [
    "PointError",
    "Validation",
    "draw_validation",
    "iter_validate",
    "iter_write_validation",
    "predicted_frame",
    "validate",
    "validation_outputs",
]

F8 = NDArray[np.float64]

PART = 1 / 3
"""Fraction of the points that are counted as the middle, and fraction counted as the edges."""

WORSE = 1.5
"""Ratio of the error at the edges to that in the middle above which the edges count as worse."""

SIGNIFICANCE = 3.0
"""Standard deviations by which the squared error at the edges must exceed that in the middle."""

WIDE = 0.2
"""Fraction of the field that points must cover to distinguish its edges from its middle."""

CAPTION = "Error of each point that was not fitted: across the sensor, and from the middle of the field to its edge."


@dataclass(frozen=True, eq=False)
class PointError:
    """Error of the prediction at a point that was not fitted.

    Attributes
    ----------
    z, y, x
        Indices of the position of the point in its scan.
    place_px
        Row and column of the image of the source on the sensor (px).
    field
        Distance from the middle of the sensor along rows or columns, whichever is larger, as a fraction of half the
        sensor's size; 1 at the edge.
    model
        Comparison with the prediction of the fitted camera at this position, with its relative error (L2).
    periodic
        Comparison with the prediction by H, which assumes that all periods are equal; None if the point is in the
        region of H.
    """

    z: int
    y: int
    x: int
    place_px: tuple[float, float]
    field: float
    model: Compared
    periodic: Compared | None

    def to_dict(self) -> dict[str, Any]:
        """Return the values as plain JSON types."""
        return {
            "position": [self.z, self.y, self.x],
            "pixel": self.place_px,
            "field": self.field,
            "error": self.model.error.to_dict(),
            "chi2": self.model.chi_square.lit,
            "displacement_px": self.model.displacement_px,
            "light": self.model.gain,
            "periodic": None if self.periodic is None else self.periodic.error.to_dict(),
        }


@dataclass(frozen=True, eq=False)
class Validation:
    """Errors of the predictions at all points that were not fitted.

    Attributes
    ----------
    points
        The points, from the middle of the field to its edges.
    """

    points: tuple[PointError, ...]

    def error(self, points: tuple[PointError, ...] | None = None, *, periodic: bool = False) -> ModelError:
        """Return the error over ``points`` (None: all) of the fitted camera or, if ``periodic``, of a periodic H.

        For points in the region of H, the error of the fitted camera is always used.
        """
        some = self.points if points is None else points
        beside = [(one.periodic or one.model) if periodic else one.model for one in some]
        powers = np.array([float(np.square(one.light[one.weight > 0]).sum()) for one in beside])
        share = powers / powers.sum()
        squared = float(share @ [one.error.squared for one in beside])
        sigma = math.sqrt(float(share**2 @ [one.error.squared_sigma**2 for one in beside]))
        return ModelError(squared, sigma, 0.0, len(beside))

    @property
    def middle(self) -> tuple[PointError, ...]:
        """One third of the points: those nearest to the middle of the field."""
        return self.points[: max(1, round(PART * len(self.points)))]

    @property
    def edges(self) -> tuple[PointError, ...]:
        """One third of the points: those farthest from the middle of the field."""
        return self.points[-max(1, round(PART * len(self.points))) :]

    @property
    def wide(self) -> bool:
        """Whether `PointError.field` spans more than 0.2, enough to distinguish the field's edges from its middle."""
        return self.points[-1].field - self.points[0].field > WIDE

    def worse(self, *, periodic: bool) -> bool:
        """Return whether the error at the edges is significantly larger than in the middle, by a factor above 1.5.

        If the points are not `wide`, the result is False. ``periodic`` is as in `error`.
        """
        inner, outer = self.error(self.middle, periodic=periodic), self.error(self.edges, periodic=periodic)
        significant = outer.squared - inner.squared > SIGNIFICANCE * math.hypot(
            outer.squared_sigma, inner.squared_sigma
        )
        return self.wide and significant and outer.squared > WORSE**2 * max(0.0, inner.squared)

    @property
    def verdict(self) -> str:
        """Summary of the points, as one line."""
        said = f"{len(self.points)} held-out points: error {self.error()}"
        if not self.wide:
            return f"{said}; all points are in one part of the field, so its edges were not tested"
        edges = f"middle {self.error(self.middle)}, edges {self.error(self.edges)}"
        if self.worse(periodic=False):
            return f"{said}; the camera is not valid at the field's edges: {edges}"
        if self.worse(periodic=True):
            lost = f"middle {self.error(self.middle, periodic=True)}, edges {self.error(self.edges, periodic=True)}"
            return f"{said}; but H is not periodic over the field: with the same H everywhere, {lost}"
        return f"{said}; {edges}"

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, points, and errors of the fitted camera and of H assumed periodic, as plain JSON types."""
        parts = {"all": self.points, "middle": self.middle, "edges": self.edges}
        errors = {
            how: {name: self.error(part, periodic=how == "periodic").to_dict() for name, part in parts.items()}
            for how in ("camera", "periodic")
        }
        return {
            "format": "lfcal-validation",
            "version": 1,
            "verdict": self.verdict,
            "edges_seen": self.wide,
            "camera_worse_at_edges": self.worse(periodic=False),
            "period_lost": self.worse(periodic=True),
            "errors": errors,
            "points": [one.to_dict() for one in self.points],
        }


class _ByModel:
    """Prediction of the pattern of a source at or near a position."""

    def __init__(self, model: PlaneModel, y: int, x: int, cutout: tuple[int, int], response: float) -> None:
        self._model, self._place = model, np.array([[y, x]], np.intp)
        self.valid = np.ones(cutout, np.bool_)
        # uneven pixel response is not an error of the model
        self.noise: F8 = np.square(response * self.at(np.zeros(2)))
        self.reach = (0.75, 0.75)

    def at(self, offset: F8) -> F8:
        """Return the pattern at unit gain of a source displaced by ``offset`` pixels."""
        found: F8 = self._model.patterns(self._place, offset[None, :])[0].astype(np.float64)
        return found

    def doubt(self, offset: F8) -> float:
        """Return 0, because the model itself is tested."""
        return 0.0


def iter_validate(fit: Fit | StoredFit, withheld: Measured, *, another: bool = False) -> Work[Validation]:
    """Return the errors of a fit in predicting patterns that were not fitted.

    For each pattern, gain, background and position of the source are fitted. The error is the residual beyond the
    noise.

    Parameters
    ----------
    fit
        The fitted camera, or the contents of its folder (`lfcal.fit.stored.read_fit`).
    withheld
        Patterns of the same scan, of which only those that were not fitted are used, or of another scan elsewhere in
        the field.
    another
        Whether the patterns come from another recording, so that even those at fitted positions were not fitted.

    Yields
    ------
    Progress
        Counted in points.

    Raises
    ------
    InputError
        If all patterns are at positions used by the fit, or come from a sensor with another number of pixels. Also if a
        pattern has fewer than nine usable samples, or no light above its noise.
    """
    known_of = fit if isinstance(fit, StoredFit) else StoredFit.of(fit)
    same = known_of.is_of(withheld.plan)
    seen = known_of.positions if same and not another else frozenset()
    known = [k for k, at in enumerate(withheld.index.tolist()) if tuple(at) not in seen]
    if not known:
        raise InputError.expected(
            "held-out points", "points that were not fitted", "none", "give points at other positions, or record more"
        )
    if withheld.plan.camera.sensor.shape != known_of.setup.camera.sensor.shape:
        shapes = known_of.setup.camera.sensor.shape, withheld.plan.camera.sensor.shape
        raise InputError.expected(
            "sensor of the held-out points",
            format_pixels(shapes[0]),
            format_pixels(shapes[1]),
            "give a recording of this sensor",
        )
    clock = Clock("predict held-out points", len(known))
    yield clock.at(0)
    points = []
    for z in np.unique(withheld.index[known, 0]).tolist():
        model, near = _models(known_of, withheld, z, periodic=not same)
        for k in known:
            if withheld.index[k, 0] == z:
                points.append(_point(known_of, withheld, k, model, near))
                yield clock.at(len(points))
    return Validation(tuple(sorted(points, key=lambda one: one.field)))


validate = drained(iter_validate)


class _Image:
    """A predicted frame without a displacement of a source to fit."""

    def __init__(self, light: F8, margin: tuple[int, int]) -> None:
        self._light = light
        self.valid = np.zeros(light.shape, np.bool_)
        # light from beyond the volume reaches the borders
        rows, columns = margin
        self.valid[rows : light.shape[0] - rows, columns : light.shape[1] - columns] = True
        self.noise: F8 = np.zeros(light.shape)
        self.reach = (0.0, 0.0)

    def at(self, offset: F8) -> F8:
        """Return the frame, whatever the ``offset``."""
        return self._light

    def doubt(self, offset: F8) -> float:
        """Return 0, because the frame itself is tested."""
        return 0.0


def predicted_frame(light: F8, frame: NewFrame, noise: tuple[float, float], cutout: tuple[int, int]) -> Compared:
    """Compare the frame of a known object with its prediction.

    Parameters
    ----------
    light
        Object projected through H, ``(rows, columns)``, in any unit, because gain and background are fitted.
    frame
        Recorded frame with the dark level subtracted.
    noise
        Constant and slope of the variance of a sample, as in `NewFrame`.
    cutout
        Size ``(rows, columns)`` of the cutout of H (px). On each side, a border of half this size, but at most a third
        of the frame, is not compared.

    Raises
    ------
    InputError
        If the frame has another size, fewer than nine usable samples, or no light above its noise.
    """
    if frame.values.shape != light.shape:
        raise InputError.expected(
            f"{frame.label}, size",
            format_pixels(light.shape),
            format_pixels(frame.values.shape),
            "use a frame of this sensor",
        )
    rows, columns = light.shape
    at = LocatedPattern(0, 0, 0, frame.origin[0] + (rows - 1) // 2, frame.origin[1] + (columns - 1) // 2, 1.0)
    margin = (min(cutout[0] // 2, rows // 3), min(cutout[1] // 2, columns // 3))
    return compared_with(_Image(light, margin), frame, at, noise)


def _models(fit: StoredFit, withheld: Measured, z: int, *, periodic: bool) -> tuple[PlaneModel, PlaneModel | None]:
    """Return the models of the fitted camera at the points of a plane and, if ``periodic``, at the fitted scan."""
    depth = withheld.plan.depths_um[z]
    order = np.argsort(fit.depths_um)
    planes, errors = np.array(fit.depths_um)[order], np.array(fit.setup.depth_errors_um)[order]
    setup = replace(fit.whole_setup, depth_errors_um=(float(np.interp(depth, planes, errors)),))
    here = replace(withheld.plan, depths_um=(depth,), exposure_s=withheld.plan.exposures[z])
    there = replace(here, anchor=fit.anchor, period=fit.period)
    model = PlaneModel(setup, setup.plan(here), 0, Fineness.finest)
    ideal = replace(setup, stage_scale=0.0)
    return model, PlaneModel(ideal, setup.plan(there), 0, Fineness.finest) if periodic else None


def _point(fit: StoredFit, withheld: Measured, k: int, model: PlaneModel, near: PlaneModel | None) -> PointError:
    plan = withheld.plan
    z, y, x = (int(v) for v in withheld.index[k])
    row, column = math.floor(plan.anchor[0] + 0.5) + y, math.floor(plan.anchor[1] + 0.5) + x
    nt, ns = plan.cutout
    place = (plan.anchor[0] + y, plan.anchor[1] + x)
    frame = NewFrame(
        withheld.patterns[k],
        withheld.valid[k],
        origin=(row - (nt - 1) // 2, column - (ns - 1) // 2),
        place=place,
        label=f"(z, y, x) = ({z}, {y}, {x})",
    )
    noise = (float(withheld.noise[k, 0]), float(withheld.noise[k, 1]))
    at, response = LocatedPattern(z, y, x, row, column, 1.0), fit.response
    beside = compared_with(_ByModel(model, y, x, plan.cutout, response), frame, at, noise)
    periodic = None
    if near is not None:
        base = [math.floor(a + 0.5) for a in fit.anchor]
        phase = [(v - b) % n for v, b, n in zip((row, column), base, fit.period, strict=True)]
        periodic = compared_with(_ByModel(near, phase[0], phase[1], plan.cutout, response), frame, at, noise)
    sensor = plan.camera.sensor
    away = [abs(v - c) / (n / 2) for v, c, n in zip(place, sensor.centre_px, sensor.shape, strict=True)]
    return PointError(z, y, x, place, float(max(away)), beside, periodic)


def validation_outputs(folder: Path) -> tuple[Path, Path]:
    """Return the paths of the results (JSON) and the plot that `iter_write_validation` writes into ``folder``."""
    return folder / "validation.json", folder / REPORT / "validation.png"


def iter_write_validation(
    fit: StoredFit, withheld: Measured, folder: Path, source: str, *, another: bool = False
) -> Work[Validation]:
    """Validate a fit with `iter_validate`, write the result into the folder of the fit, and return it.

    Results (JSON) and plot are written to separate files, and the plot is added to the report. ``source`` is the name
    of the recording.
    """
    found = yield from iter_validate(fit, withheld, another=another)
    numbers, picture = validation_outputs(folder)
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw_validation(found, picture)
    add_picture(picture.parent, "Points that were not fitted", found.verdict, picture, CAPTION)
    write_text(numbers, json_text({**found.to_dict(), "source": source}))
    return found


def draw_validation(found: Validation, path: str | os.PathLike[str]) -> None:
    """Save a figure of the error of each point, as a map of the sensor and as a function of `PointError.field`."""
    errors = np.array([_shown(one.model.error) for one in found.points])
    with figure(9.6, 3.4) as fig:
        places, line = fig.subplots(1, 2)
        dots = places.scatter(
            [one.place_px[1] for one in found.points], [one.place_px[0] for one in found.points], c=100 * errors, s=24
        )
        places.invert_yaxis()
        places.set(title="error of each point", xlabel="sensor column (px)", ylabel="sensor row (px)")
        fig.colorbar(dots, ax=places, shrink=0.85).set_label("%")
        field = [one.field for one in found.points]
        line.plot(field, 100 * errors, "o", color=LINES[0], markersize=4, label="fitted camera")
        if any(one.periodic is not None for one in found.points):
            periodic = [_shown((one.periodic or one.model).error) for one in found.points]
            line.plot(field, 100 * np.array(periodic), "s", color=LINES[1], markersize=4, label="H, assumed periodic")
            line.legend()
        line.set(title="from the centre of the sensor to its edge", xlabel="position in the field", ylabel="error (%)")
        line.set_ylim(bottom=0)
        save_figure(fig, path)


def _shown(error: ModelError) -> float:
    return math.sqrt(max(0.0, error.squared))
