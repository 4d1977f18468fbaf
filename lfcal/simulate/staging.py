"""Make the scene for an engine from a camera, a plan and a tuple of effects."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of, choose
from lfcal.camera import Camera, LensletLattice, Microscope, NoLatticeError, ScanPlan
from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.effects import (
    Bandwidth,
    Effect,
    LightEffect,
    LightSample,
    Outlook,
    PsfEffect,
    PupilOutlook,
    SceneEffect,
)
from lfcal.simulate.engines import LEVELS
from lfcal.simulate.scene import PupilIris, Scene

__all__ = [
    "check_applicable",
    "filter_kernel",
    "filtered",
    "grid_pixel",
    "ideal_scene",
    "lattice_scene_for",
    "light_samples",
    "origin_of",
    "outlook_of",
    "resolve_level",
    "scene_for",
    "scene_of",
    "wave_level",
]


def scene_of(
    camera: Camera,
    z_um: float | None = None,
    *,
    virtual_depth: float | None = None,
    cutout: tuple[int, int],
    period: tuple[int, int] | None = None,
    anchor_px: tuple[float, float] = (0.0, 0.0),
    gap_um: float | None = None,
    **overrides: Any,
) -> Scene:
    """Return the scene of one depth plane of ``camera``.

    Parameters
    ----------
    camera
        Camera description.
    z_um, virtual_depth
        Object depth of the plane (µm), or its virtual depth; without either, the native plane.
    cutout, period
        Pixels ``(nt, ns)`` of a response, and number of source positions ``(ny, nx)``. If ``period`` is None, it is
        that of the camera, rounded.
    anchor_px
        Point (y, x) on the sensor onto which source position (0, 0) is imaged, in pixels relative to the centre of a
        type-0 micro-image.
    gap_um
        Distance from lenslets to sensor (µm). None: the camera's. The image does not move.
    overrides
        Fields of `Scene` to set, for example ``pupil_um=math.inf`` for a telecentric model.

    Raises
    ------
    InputError
        If a depth is given twice, a field is unknown, or a value is out of range.
    """
    # an unknown field would otherwise be ignored, and the camera's value used
    unknown = sorted(set(overrides) - {f.name for f in fields(Scene)})
    if unknown:
        raise InputError.expected("scene", "names of fields of Scene", unknown[0], "correct the name")
    if z_um is not None and virtual_depth is not None:
        raise InputError.expected("depth", "a depth z or a virtual depth", "both", "give one of the two")
    positions = _whole_period(camera) if period is None else period
    # one of the two is computed from the other, so that a and z always agree
    depth = camera.depth_of(virtual_depth) if virtual_depth is not None else float(z_um or 0.0)
    a = virtual_depth * camera.lattice.gap_um if virtual_depth is not None else camera.image_shift_um(depth)
    lattice = _on_array(camera, anchor_px)
    if gap_um is not None:
        lattice = replace(lattice, gap_um=gap_um)
    known = {"image_um": a, "z_um": depth, "lattice": lattice, "cutout": cutout, "period": positions}
    return Scene(**(_described(camera) | known | overrides))


def _described(camera: Camera) -> dict[str, Any]:
    """Return the fields of a scene that are the same in every plane of ``camera``."""
    optics, lattice, sensor = camera.optics, camera.lattice, camera.sensor
    known: dict[str, Any] = {
        "wavelength_um": camera.wavelength_um,
        "pixel_um": sensor.pixel_um,
        "f_number": optics.working_f_number,
        "aperture": "cell" if lattice.gapless else "circle",
        # the share refers to the area: the side is its square root
        "pixel_fill": math.sqrt(sensor.fill_factor),
    }
    if isinstance(optics, Microscope):
        return known | {"objective": optics}
    iris = PupilIris(optics.blades, optics.blade_curvature, optics.blade_rotation_rad)
    return known | {"iris": iris, "pupil_um": optics.image_distance_um}


def _whole_period(camera: Camera) -> tuple[int, int]:
    y, x = camera.period_px
    return max(1, round(y)), max(1, round(x))


def _on_array(camera: Camera, anchor_px: tuple[float, float]) -> LensletLattice:
    """Return the lenslets themselves: the micro-image lattice divided by `Camera.lattice_scale`."""
    # with a distorted lattice, a scene has the cell of the sensor's middle, unless `Camera.local` chose another
    seen, s, px = camera.lattice.local((0.0, 0.0)), camera.lattice_scale, camera.sensor.pixel_um
    # shifted with the anchor: distances on the sensor are s times those on the array
    y, x = anchor_px
    return replace(seen.scaled(1 / s), offset_um=(-x * px / s, -y * px / s))


Real = TypeVar("Real", np.float32, np.float64)

ALL_LEVELS = ("auto", "microscope", *LEVELS)


def outlook_of(plan: ScanPlan, z: int, *, peak: float = 0.8) -> Outlook:
    """Return the input for the estimates of effects in plane ``z``, at the middle of the plan's period.

    ``peak`` is the fraction of the full well that the brightest pixel reaches.
    """
    camera = plan.cell_camera
    middle = np.array(plan.anchor) + (np.array(plan.period) - 1) / 2
    field = (middle - np.array(camera.sensor.centre_px)) * camera.sensor.pixel_um
    kind = Outlook if camera.has_lattice else PupilOutlook
    return kind(
        camera,
        plan.depths_um[z],
        plan.cutout,
        plan.period,
        (float(field[0]), float(field[1])),
        peak * camera.sensor.full_well_e,
        plan.exposures[z],
    )


def origin_of(plan: ScanPlan) -> tuple[int, int, float, float]:
    """Return the pixel (row, column) of position (0, 0), and the offset (y, x) of its chief ray from the pixel (px)."""
    row, column = (math.ceil(v - 0.5) for v in plan.anchor)
    return row, column, plan.anchor[0] - row, plan.anchor[1] - column


def grid_pixel(plan: ScanPlan, *, on_sensor: bool = False) -> tuple[float, float]:
    """Return the width (µm) and the ratio of height to width of the pixels of H; with ``on_sensor``, of the sensor."""
    width = plan.camera.sensor.pixel_um
    if on_sensor or not plan.resample:
        return width, 1.0
    fy, fx = plan.resample_factors
    aspect = fx / fy
    # equal periods give factors that differ only by rounding
    return width / fx, 1.0 if abs(aspect - 1) < 1e-9 else aspect


def ideal_scene(plan: ScanPlan, outlook: Outlook, *, halo: int = 0, on_sensor: bool = False) -> Scene:
    """Return the scene of the ideal telecentric camera: rays, a round iris, and all lenslets of the sharpest type.

    ``outlook`` contains the depth, at which the sharpest type has the least defocus. The cutout is ``halo`` pixels
    larger than the plan's on every side. Pixels are those of H, which may be resampled, or with ``on_sensor`` those of
    the sensor.
    """
    camera = outlook.camera
    _, _, residual_y, residual_x = origin_of(plan)
    width, aspect = grid_pixel(plan, on_sensor=on_sensor)
    if plan.resample and not on_sensor:
        residual_y = residual_x = 0.0  # resampled pixels are centred on the chief ray
    about = plan.lattice_anchor
    offsets = None
    # engines have the chief ray of position (0, 0) at a pixel's centre; the remainder displaces every source
    if residual_y or residual_x:
        offsets = np.broadcast_to(np.array([residual_y, residual_x]) * camera.sensor.pixel_um, (*plan.period, 2)).copy()
    sharpest = int(np.argmin(np.abs(outlook.defocus)))
    scene = scene_of(
        camera,
        period=plan.period,
        cutout=(plan.cutout[0] + 2 * halo, plan.cutout[1] + 2 * halo),
        z_um=outlook.z_um,
        anchor_px=(about[0] - residual_y, about[1] - residual_x),
        iris=PupilIris(),
        pixel_um=width,
        pixel_aspect=aspect,
        pupil_um=math.inf,
        pixel_fill=1.0,
        main_diffraction=False,
        lenslet_diffraction=False,
        offsets_um=offsets,
    )
    # the sharpest type for all lenslets, because lens types are a separate effect
    types = (camera.lattice.types[sharpest],) * len(camera.lattice.types)
    return replace(scene, lattice=replace(scene.lattice, types=types))


def wave_level(camera: Camera) -> str:
    """Return the wave level for a camera: ``"debye"`` for a microscope with a lenslet lattice, otherwise ``"wave"``."""
    return "debye" if camera.optics.telecentric and camera.has_lattice else "wave"


def check_applicable(camera: Camera, effects: Iterable[Effect]) -> None:
    """Raise `NoLatticeError` if an effect needs a lenslet lattice and the camera has none."""
    for effect in effects:
        if not effect.applies_to(camera):
            raise NoLatticeError.of(f"effect {effect.name}")


def _pupil_scene(plan: ScanPlan, outlook: Outlook, halo: int) -> PupilScene:
    """Return the scene of a Fourier light-field microscope, whose period of one pixel is never resampled."""
    assert isinstance(outlook, PupilOutlook)
    _, _, residual_y, residual_x = origin_of(plan)
    about, px = plan.lattice_anchor, plan.camera.sensor.pixel_um
    offsets = None
    if residual_y or residual_x:
        offsets = np.broadcast_to(np.array([residual_y, residual_x]) * px, (*plan.period, 2)).copy()
    return replace(
        outlook.scene,
        cutout=(plan.cutout[0] + 2 * halo, plan.cutout[1] + 2 * halo),
        axis_um=((residual_y - about[0]) * px, (residual_x - about[1]) * px),
        offsets_um=offsets,
    )


def scene_for(
    plan: ScanPlan,
    z: int,
    effects: Iterable[Effect],
    *,
    halo: int = 0,
    depth_error_um: float = 0.0,
    on_sensor: bool = False,
) -> AnyScene:
    """Return the scene of plane ``z`` with all scene effects among ``effects``.

    ``depth_error_um`` is the displacement of the plane away from the camera, relative to the plan (µm). ``halo`` and
    ``on_sensor`` are as in `ideal_scene`; without a lenslet lattice, ``on_sensor`` is ignored.

    Raises
    ------
    NoLatticeError
        If an effect needs a lenslet lattice and the camera has none.
    """
    outlook = outlook_of(plan, z)
    if depth_error_um:
        outlook = replace(outlook, z_um=outlook.z_um + depth_error_um)
    chosen = tuple(effects)
    check_applicable(plan.camera, chosen)
    scene: Any = (
        ideal_scene(plan, outlook, halo=halo, on_sensor=on_sensor)
        if plan.camera.has_lattice
        else _pupil_scene(plan, outlook, halo)
    )
    for effect in chosen:
        if isinstance(effect, SceneEffect):
            scene = effect.on_scene(scene, outlook)
    found: AnyScene = scene
    return found


def lattice_scene_for(plan: ScanPlan, z: int, effects: Iterable[Effect], *, depth_error_um: float = 0.0) -> Scene:
    """Return the scene, as `scene_for` does, for a camera with a lenslet lattice.

    Raises
    ------
    NoLatticeError
        If the camera has no lenslet lattice.
    """
    scene = scene_for(plan, z, effects, depth_error_um=depth_error_um)
    if isinstance(scene, PupilScene):
        raise NoLatticeError.of("this calculation")
    return scene


@overload
def resolve_level(scene: Scene, level: str = "auto") -> tuple[Scene, str]: ...
@overload
def resolve_level(scene: AnyScene, level: str = "auto") -> tuple[AnyScene, str]: ...
def resolve_level(scene: AnyScene, level: str = "auto") -> tuple[AnyScene, str]:
    """Return the scene and the engine's level for ``level``; ``auto`` means rays unless an effect needs waves.

    For a camera without a lenslet lattice, ``auto`` always means waves, and the scene is not changed. Otherwise, a wave
    level given by name always includes lenslet diffraction, and ``microscope`` means the Debye path.
    """
    from lfcal.simulate.engines import choose_mode  # compiled code: loaded only when it is needed

    if level not in ALL_LEVELS:
        raise InputError.expected("level", any_of(ALL_LEVELS), repr(level), choose(level, ALL_LEVELS))
    if isinstance(scene, PupilScene):
        return scene, "wave" if level == "auto" else level  # its engine refuses levels that it has not
    if level == "microscope":
        level = "debye"
    if level == "auto":
        if not scene.lenslet_diffraction:
            return scene, "geometric"
        level = "debye" if scene.objective is not None else "wave"
    if level != "geometric" and not scene.lenslet_diffraction:
        scene = replace(scene, lenslet_diffraction=True)
    # here, fringes and shadow are one integral and cannot be separated
    inseparable = scene.objective is not None or choose_mode(scene) == "U"
    if level != "geometric" and inseparable and not scene.main_diffraction:
        scene = replace(scene, main_diffraction=True)  # see `IrisDiffraction`
    return scene, level


def light_samples(effects: Iterable[Effect], outlook: Outlook) -> tuple[LightSample, ...]:
    """Return the source points and wavelengths, with weights, over which ``effects`` spread the light.

    If an effect depends on the wavelength, the number of wavelengths is sufficient for it, even without `Bandwidth`.
    """
    chosen = tuple(effects)
    coloured = [effect for effect in chosen if effect.by_wavelength and effect.wavelengths(outlook) > 1]
    least = max((effect.wavelengths(outlook) for effect in coloured), default=1)
    if coloured and not any(isinstance(effect, Bandwidth) for effect in chosen):
        widths = (effect.spectrum_um() for effect in coloured)
        chosen = (*chosen, Bandwidth(next((width for width in widths if width is not None), None)))
    samples: tuple[LightSample, ...] = (LightSample(0.0, 0.0, outlook.wavelength_um, 1.0),)
    for effect in chosen:
        if isinstance(effect, Bandwidth):
            samples = effect.spread(samples, outlook, least)
        elif isinstance(effect, LightEffect):
            samples = effect.spread(samples, outlook)
    return samples


def filter_kernel(
    effects: Sequence[Effect], camera: Camera
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]] | None:
    """Return the combined filter ``(rows, columns)`` of all response effects, of odd size; None if it has no effect."""
    kernel: NDArray[np.float64] | None = None
    for effect in effects:
        if isinstance(effect, PsfEffect):
            one = effect.kernel(camera)
            # a filter without effect would still cost its margin, and rounding errors
            if np.count_nonzero(one) == 1 and one[one.shape[0] // 2, one.shape[1] // 2] == 1:
                continue
            # the whole combined kernel: values of the other one extend by half of this one's sides
            kernel = one if kernel is None else filtered(np.pad(one, [(n // 2, n // 2) for n in kernel.shape]), kernel)
    return kernel


def filtered(values: NDArray[Real], kernel: NDArray[np.float64]) -> NDArray[Real]:
    """Return ``values`` convolved along the last two axes with a small ``kernel``, whose sides are odd.

    Values beyond the border count as zero; shape and type are those of ``values``.
    """
    out = np.zeros_like(values)
    rows, columns = values.shape[-2:]
    ht, hs = kernel.shape[0] // 2, kernel.shape[1] // 2
    for dy in range(-ht, ht + 1):
        for dx in range(-hs, hs + 1):
            weight = values.dtype.type(kernel[ht + dy, hs + dx])
            to = (..., slice(max(0, dy), rows + min(0, dy)), slice(max(0, dx), columns + min(0, dx)))
            of = (..., slice(max(0, -dy), rows + min(0, -dy)), slice(max(0, -dx), columns + min(0, -dx)))
            out[to] += weight * values[of]
    return out
