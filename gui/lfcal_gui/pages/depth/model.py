"""Settings of a depth map, how they become the task, and what the picture shows of the map. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work, format_bytes, format_length, format_seconds
from lfcal.frames import parse_origin
from lfcal.records import from_flat
from lfcal.tasks import Depth
from lfcal_gui.models import (
    CAMERA_FILE,
    Field,
    PageSettings,
    ProjectState,
    Shot,
    Tint,
    capital,
    described,
    fields_of,
    options_in,
)

if TYPE_CHECKING:
    from lfcal.camera import Camera
    from lfcal.lattice import DepthMap
    from lfcal.tasks import DepthForecast, MeasuredDepth

HELD = frozenset({"frame", "out", "cloud", "camera", "psf"})
"""Fields of the task that have their own widgets: buttons for files, check boxes for camera and H of the project."""

NO_CAMERA = (
    "No camera is described. Describe one in Set up, or choose a white image to measure slopes instead of depths"
)
NO_H = "The project has no H"

FIELDS: tuple[Field, ...] = (
    Field(
        "use_camera",
        "Camera of the project",
        kind="bool",
        tip="Use the lattice, lens types and distances of the camera in Set up; depths are then in µm. "
        "Off: the lattice comes from a white image or a lattice file, and slopes are measured instead of depths",
        default=True,
    ),
    Field(
        "use_h",
        "H of the project",
        kind="bool",
        tip="Correct the depth scale by the planes of H, if the project has an H of the same camera",
        default=False,
    ),
    *(replace(one, late=bool(one.file) or one.late) for one in fields_of(Depth, without=HELD)),
)

BASIC = ("use_camera", "use_h", "white", "dark")
"""Keys of fields that are always visible."""


@dataclass(frozen=True)
class DepthSettings(PageSettings):
    """Settings of the page.

    Attributes
    ----------
    use_camera, use_h
        Whether camera and H of the project are used.
    options
        Pairs of name and value of the fields of `lfcal.tasks.Depth` that are not at their defaults.
    """

    page: ClassVar[str] = "depth"

    use_camera: bool = True
    use_h: bool = False
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def option_values(self) -> dict[str, Any]:
        """Values of ``options`` by name, with the types of the fields of the task."""
        return options_in(Depth, dict(self.options))

    def usable(self) -> None:
        """Raise `InputError` if values do not match."""
        parse_origin(str(self.option_values.get("origin", "")))
        from_flat(Depth, {"frame": "frame.tif", "out": "depth.tif", "camera": CAMERA_FILE, **self.option_values})

    def changed(self, key: str, value: Any) -> DepthSettings:
        """Return the settings with one value changed."""
        if key in ("use_camera", "use_h"):
            return replace(self, **{key: value})
        chosen = options_in(Depth, {**self.option_values, key: value})
        # a project is written as JSON, which has no paths
        plain = {name: str(one) if isinstance(one, Path) else one for name, one in chosen.items()}
        found = replace(self, options=tuple(sorted(plain.items())))
        found.usable()
        return found


def camera_of(settings: DepthSettings, project: ProjectState) -> Camera | None:
    """Return the camera of the project if it is used; None if it is not used or was not described."""
    return project.camera if settings.use_camera and described(project) else None


def camera_files(project: ProjectState) -> tuple[tuple[str, str], ...]:
    """Return the camera file that a command reads; empty if it reads none."""
    camera = camera_of(DepthSettings.of(project), project)
    return () if camera is None else ((CAMERA_FILE, camera.to_json()),)


def task_of(settings: DepthSettings, project: ProjectState, frame: str, out: str = "") -> Depth:
    """Return the task that measures the depth map of a frame.

    The map is written to ``out``. If this ends in ``.ply``, a point cloud is also written.

    Raises
    ------
    InputError
        If nothing determines the lattice, or values do not match.
    """
    path, options = Path(out or "depth.tif"), settings.option_values
    camera, psf = camera_of(settings, project), project.psf if settings.use_h else ""
    if camera is None and not (psf or options.get("white") or options.get("lattice")):
        wanted, remedy = "a camera, a white image or a lattice file", "describe the camera in Set up, or choose a file"
        raise InputError.expected("lattice", wanted, "none", remedy)
    own: dict[str, Any] = {
        "frame": Path(frame),
        "out": path.with_suffix(".tif") if path.suffix == ".ply" else path,
        "cloud": path if path.suffix == ".ply" else None,
        "camera": "" if camera is None else CAMERA_FILE,
        "psf": Path(psf) if psf else None,
    }
    return from_flat(Depth, own | options)


def frame_picture(path: str) -> NDArray[Any]:
    """Return the displayed image of a frame ``(rows, columns)``; for several colours, their mean."""
    from lfcal.frames import read_image

    image = read_image(Path(path))
    return image if image.ndim == 2 else image.mean(-1)


def forecast_words(found: DepthForecast, workers: int) -> str:
    """Return the forecast of a measurement as text."""
    threads = "1 thread" if workers == 1 else f"{workers} threads"
    time, memory = format_seconds(found.seconds), format_bytes(found.memory)
    return f"Takes {time} of processor time on {threads}, and {memory} of memory."


class Shade(NamedTuple):
    """A quantity that is shown in colour: name, unit, values ``(rows, columns)`` and standard errors."""

    name: str
    unit: str
    values: NDArray[np.floating[Any]]
    sigma: NDArray[np.floating[Any]]

    def words(self, value: float) -> str:
        """Return a value with its unit."""
        if self.unit == "µm":
            return format_length(value)
        return f"{value:.3g}{f' {self.unit}' if self.unit else ''}"


QUANTITIES = {"depth": "Depth", "slope": "Slope (virtual depth)", "disparity": "Disparity"}
"""Quantities that can be shown in colour."""


def shades_of(found: DepthMap) -> dict[str, Shade]:
    """Return the quantities of a map; there is no depth without a camera."""
    unit = "samples" if found.method == "views" else "px"
    shades = {
        "slope": Shade("slope", "", found.slope, found.sigma),
        "disparity": Shade("disparity", unit, found.disparity, found.disparity_sigma),
    }
    if found.z_um is None or found.z_sigma_um is None:
        return shades
    return {"depth": Shade("depth", "µm", found.z_um, found.z_sigma_um), **shades}


ENDS = (0.01, 0.99)
"""Quantiles of the samples at the ends of the colour scale."""


BRIGHTER = 0.5
"""Fraction of the brightness range by which the darkest sample is raised, so that its colour is visible."""


def shot_of(found: DepthMap, shade: Shade, least: float) -> Shot:
    """Return the central view in the colours of a quantity; samples with a confidence below ``least`` are grey."""
    values = np.where(found.confidence >= least, shade.values, np.nan)
    good = values[np.isfinite(values)]
    low, high = (float(v) for v in np.quantile(good, ENDS)) if good.size else (0.0, 1.0)
    tint = (values - low) / (high - low if high > low else 1.0)
    dark, bright = (float(v) for v in np.quantile(found.image, (0.001, 0.999)))
    dark -= BRIGHTER * (bright - dark)
    return Shot(
        found.image,
        f"{capital(shade.name)} over the central view",
        "light of the central view (relative)",
        "depth",
        levels=(dark, bright if bright > dark else dark + 1),
        origin=found.corner_px,
        step=found.step_px[1],
        tint=Tint(tint.astype(np.float32), (shade.words(low), shade.words(high))),
    )


def readout(found: DepthMap, shades: Mapping[str, Shade], row: int, column: int) -> str:
    """Return the results for a sample as text: every quantity with its standard error, and the confidence."""
    if not math.isfinite(found.slope[row, column]):
        return "depth unknown: no texture, or no agreement"
    parts = []
    for shade in shades.values():
        value, error = float(shade.values[row, column]), float(shade.sigma[row, column])
        if math.isfinite(value):
            parts.append(f"{shade.name} {shade.words(value)} ± {shade.words(error)}")
    return ", ".join((*parts, f"confidence {100 * float(found.confidence[row, column]):.0f} %"))


def fact_rows(made: MeasuredDepth) -> tuple[tuple[str, str], ...]:
    """Return the results of the measurement as names and values."""
    facts: Mapping[str, Any] = made.to_dict()
    rows, columns = facts["shape"]
    shade = next(iter(shades_of(made.found).values()))
    depths = "none: no region has enough texture"
    if facts["depths"]:
        low, middle, high = map(shade.words, facts["depths"])
        depths = f"{low} to {high}, median {middle}"
    return (
        (capital(shade.name), depths),
        ("Samples", f"{rows} × {columns}, {100 * facts['known']:.0f} % with a depth"),
        ("Matched", made.found.method),
        ("Lattice", f"of {made.lattice}"),
        ("Scale", f"of {made.scale}" if made.scale else "none: describe the camera for depths in µm"),
        ("Time", format_seconds(made.seconds)),
    )


class Looked(NamedTuple):
    """A measured map, its quantities by key, and its facts as names and values."""

    made: MeasuredDepth
    shades: dict[str, Shade]
    facts: tuple[tuple[str, str], ...]


def iter_looked(task: Depth, camera: Camera | None) -> Work[Looked]:
    """Measure a map and compute the displayed data in the same job, so that the window stays responsive."""
    made = yield from task.iter_measured(camera)
    return Looked(made, shades_of(made.found), fact_rows(made))
