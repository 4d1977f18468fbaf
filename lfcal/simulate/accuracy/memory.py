"""Estimate the peak memory of a simulation from its description: the tables of its engines, and H."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from lfcal.base import worker_count
from lfcal.camera import ScanPlan
from lfcal.simulate._pupil_scene import PupilScene
from lfcal.simulate._symmetry import is_separable
from lfcal.simulate.accuracy.cost import efficient_steps, step_for
from lfcal.simulate.accuracy.probe import places
from lfcal.simulate.accuracy.sampling import LevelSampling, grid_extent, steps_for, tilt_orders
from lfcal.simulate.effects import Effect
from lfcal.simulate.engines import Sampling, pupil_bytes
from lfcal.simulate.plane_task import EffectsLike, PlaneTask, budgeted
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import filter_kernel, resolve_level, scene_for
from lfcal.work import RunChoice
from lfcal.work.executors import concurrent_memory, concurrent_units

__all__ = ["engine_bytes", "predict_bytes", "task_bytes"]

SMALL_PARTS = 24 << 20
"""Bytes of all small objects: matrices, outlines, lists of lenslets."""

TRIED, GRID_REFERENCE = 2, 3
"""Number of samplings usually tried for a plane, and index of the sampling on a grid that is used for comparison."""

FAST = 2.5
"""f-number below which windows and coarse grids may all be too coarse, so that the finest grid is needed."""

FAINT = 0.02
"""Fraction of the light below which relative errors in a cutout are large, so that any sampling may be tried."""

FIELD_PEAK, FIELD_STORED = 72, 16
"""Bytes per sample of the main lens's field while it is computed, and afterwards, for windows or a grid."""

CELL_PEAK, CELL_STORED, CELL_CACHED = 48, 4, 8
"""Bytes per sample of the fine table of a lenslet's cell, and of a table shared with other scenes."""

TRANSFER_PEAK = 110
"""Bytes per sample of the propagation over the gap at exact angles, while it is computed."""

WORK = 32
"""Bytes per sample of a position's grid, for each thread."""

STEPPED = 6
"""Additional bytes per value for a plane that is stored in steps and read back."""

REFERENCE = 120
"""Bytes per sample of the reference's grid, in double precision."""


def predict_bytes(
    plan: ScanPlan,
    effects: EffectsLike = "auto",
    level: str = "auto",
    *,
    tolerance: float | None = None,
    sampling: Sampling | None = None,
    to_file: bool = False,
    workers: int | None = None,
    store_tolerance: float | None = None,
    run: RunChoice | None = None,
) -> int:
    """Predict the peak memory use of `simulate_psf`, including H (bytes).

    The prediction includes the measurement of a plane's error, during which two engines are in memory.

    Parameters
    ----------
    plan, effects, level, tolerance, sampling, workers, store_tolerance, run
        As in `simulate_psf`.
    to_file
        Whether H is written to a file, so that its planes are not all in memory.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import predict_bytes
    >>> camera = preset("bench")
    >>> plan = ScanPlan.for_camera(camera, virtual_depths=[3.0, 4.0, 5.0, 6.0])
    >>> for to_file in (False, True):
    ...     need = predict_bytes(plan, (), to_file=to_file, workers=1) / 2**20
    ...     print(f"{need:.0f} MiB with H in", "a file" if to_file else "memory")
    75 MiB with H in memory
    49 MiB with H in a file
    """
    budget = budgeted(effects, plan, tolerance)
    nz, *rest = plan.shape
    held, count = 4 * math.prod(rest) * (2 if to_file else nz), worker_count(workers)
    held += 0 if store_tolerance is None else STEPPED * math.prod(rest)

    def plane(threads: int) -> int:
        """Return the bytes of one plane with a number of threads."""
        most = 0
        for z, z_um in enumerate(plan.depths_um):
            chosen, share = budget.at(z_um)
            most = max(most, _plane_bytes(plan, z, chosen, level, share, sampling, workers=threads))
        return held + most

    if run is None:
        return plane(count)
    one = plane(1)
    if run.executor != "threads":
        return count * one  # each process has its own engines
    together = concurrent_units([one] * nz, count, concurrent_memory())
    return together * one if together > 1 else plane(count)


def task_bytes(task: PlaneTask, *, stepped: bool = False) -> int:
    """Return the estimated peak memory (bytes) of simulating one plane of H with one thread, including its values.

    ``stepped``: whether the values are stored with a tolerance, which needs additional memory.
    """
    values = math.prod(task.plan.shape[1:]) * (8 + (STEPPED if stepped else 0))
    return values + _plane_bytes(task.plan, task.z, task.effects, task.level, task.tolerance, task.sampling, workers=1)


def _plane_bytes(
    plan: ScanPlan,
    z: int,
    effects: tuple[Effect, ...],
    level: str,
    share: float,
    sampling: Sampling | None,
    *,
    workers: int,
) -> int:
    scene, resolved = resolve_level(scene_for(plan, z, effects), level)
    kernel = filter_kernel(effects, plan.camera)
    # rows of responses are copied for the filter
    filtered = 0 if kernel is None else 12 * math.prod(plan.cutout) * plan.period[1] * 4
    if isinstance(scene, PupilScene):
        chosen = sampling or step_for(scene, resolved, share).sampling
        return SMALL_PARTS + filtered + pupil_bytes(scene, resolved, chosen)
    if sampling is not None:
        return SMALL_PARTS + filtered + engine_bytes(scene, LevelSampling(resolved, sampling, 0.0), workers)
    steps = efficient_steps(scene, resolved)
    first = next((k for k, step in enumerate(steps) if step.expected <= share), len(steps) - 1)
    if resolved == "reference":  # the reference is not compared with anything
        return SMALL_PARTS + filtered + engine_bytes(scene, steps[first], workers)
    # the chosen engine stays in memory while a finer one, for comparison, is made
    tried = steps[first:] if _captured_share(scene) < FAINT else steps[first : first + TRIED]
    fast = scene.f_number < FAST
    grids = [step for step in steps_for(scene, resolved) if step.level == "grid"][: GRID_REFERENCE + fast]
    others = [*tried, *grids[-1:]]
    return (
        SMALL_PARTS
        + filtered
        + max(engine_bytes(scene, step, workers) for step in others)
        + max(engine_bytes(scene, step, workers) for step in tried[: max(1, len(tried) - 1)])
    )


def _captured_share(scene: Scene) -> float:
    """Return the approximate fraction of the light that cutouts receive: their area relative to the iris's shadow.

    It is 0 if the shadows of all probed positions are so small that they fall between lenslets.
    """
    if not scene.gapless and all(_between_lenslets(scene, y, x) for y, x in product(*places(scene))):
        return 0.0
    return math.prod(scene.cutout) / max(math.pi * grid_extent(scene).shadow ** 2, 1.0)


def _between_lenslets(scene: Scene, y: int, x: int) -> bool:
    y_um, x_um = (um / scene.scale for um in scene.source_um(y, x))
    reach = scene.clear_radius_um + scene.shadow_radius_um
    centres, _ = scene.lattice.lenslets_within(reach, reach, (x_um, y_um))
    return not bool((np.hypot(*(centres - (x_um, y_um)).T) < reach).any())


def engine_bytes(scene: Scene, step: LevelSampling, workers: int) -> int:
    """Return the estimated peak memory (bytes) of an engine with the level and sampling of ``step``.

    The peak is reached during set-up, or while ``workers`` threads compute positions.
    """
    if step.level == "geometric":
        return 0
    if step.sampling.double and step.level != "reference":
        return 2 * engine_bytes(scene, replace(step, sampling=replace(step.sampling, double=False)), workers)
    if step.level == "debye":
        return _debye_bytes(scene, step.sampling)
    if step.level == "reference":
        return _reference_bytes(scene, step.sampling)
    if step.level == "grid":
        return _grid_bytes(scene, step.sampling, workers)
    return _window_bytes(scene, step.sampling)


def _field_samples(scene: Scene, dx: float, half: float, mode: str) -> float:
    """Return the approximate number of samples of the main lens's field table; see `lfcal.simulate.engines.field`."""
    fringe = math.sqrt(scene.wavelength_um * abs(scene.reduced_image_um))
    shadow = scene.shadow_radius_um
    reach = half
    if mode == "E":
        reach = max(min(shadow, half + 8 * fringe), half) + 4 * fringe
    elif mode == "U" and not (scene.iris.circular and all(m == 0 for _, m, _ in scene.wavefront)):
        reach = (half + shadow + 4 * fringe) / 0.75
    return float(min(1.03 * (2 * reach / dx + 24), 8192.0) ** 2)


def _cell_bytes(scene: Scene, dx: float, reach: float, bent: bool = False) -> tuple[float, float]:
    """Return the bytes of the table of a lenslet's cell while it is made and afterwards; 0 for a disc.

    ``bent`` tables, which a grid uses, are complex.
    """
    # compiled code: loaded only when it is needed
    from lfcal.simulate.engines import MAX_CACHED, MAX_TABLE, bent_fineness, fineness

    if scene.round_lenslets:
        return 0.0, 0.0
    fine = bent_fineness(reach / dx) if bent else fineness(reach / dx)
    side = min(2 * reach / dx * fine + 3, MAX_TABLE)
    kept = CELL_STORED + (CELL_CACHED if side <= MAX_CACHED else 0)
    return (1 + bent) * CELL_PEAK * side**2, (1 + bent) * kept * side**2


def _mode(scene: Scene) -> str:
    from lfcal.simulate.engines import choose_mode

    return choose_mode(scene)


def _fields(scene: Scene) -> int:
    from lfcal.simulate.engines import field_modes

    return len(field_modes(scene))


def _window_bytes(scene: Scene, sampling: Sampling) -> int:
    from lfcal.simulate.engines import aperture_radius, table_reach, window_of

    mode = _mode(scene)
    kept = made = 0.0
    spaced: set[float] = set()
    for kind in range(len(scene.lattice.types)):
        half_px, dx = window_of(scene, sampling, mode, kind)
        lenslet = aperture_radius(scene) + 4 * dx
        for_cell = _cell_bytes(scene, dx, lenslet)
        kept, made = kept + for_cell[1], max(made, for_cell[0])
        if dx not in spaced:
            spaced.add(dx)
            samples = _field_samples(scene, dx, table_reach(scene, sampling, mode, dx, half_px) + lenslet, mode)
            kept, made = kept + FIELD_STORED * samples, max(made, FIELD_PEAK * samples)
        window = ((2 * half_px + 1) * sampling.nodes_per_px + 4) * (lenslet / dx + 2)
        kept += 16 * window
    grids = 64 * math.prod(n * sampling.nodes_per_px + 4 for n in scene.cutout)
    return int(_fields(scene) * (kept + grids) + made)


def _grid_bytes(scene: Scene, sampling: Sampling, workers: int) -> int:
    per = round(sampling.samples_per_px or 4)
    side = grid_extent(scene).side(per, sampling.margin_px)
    dx = scene.reduced_pixel_um / per
    array = 8 * math.prod(side + per * n for n in scene.period)
    field = _field_samples(scene, dx, side * dx / 2 + scene.farthest_um / scene.scale, _mode(scene))
    made, kept = _cell_bytes(scene, dx, scene.lattice.pitch_um, bent=True)
    kinds, orders = len(scene.lattice.types), tilt_orders(scene, side * dx / 2)
    # each order of a tilted array has a spectrum and a field, and the sums need memory too
    tilted = 8 * side**2 * (2 * orders + 4 + 2 * workers) if orders > 1 else 0
    at_work = (WORK * workers + 16) * side**2 + 24 * field
    peak = max(FIELD_PEAK * field, TRANSFER_PEAK * side**2, made, at_work)
    # the fields of a microscope share the table of the array
    return int(tilted + array + 8 * side**2 + kinds * kept + _fields(scene) * (8 * field + 8 * side**2) + peak)


def _reference_bytes(scene: Scene, sampling: Sampling) -> int:
    from lfcal.simulate.engines import REFERENCE_CACHE_BYTES

    extent, px = grid_extent(scene), scene.reduced_pixel_um
    blur = 4 * math.sqrt(scene.wavelength_um * abs(scene.reduced_image_um))
    lit = 1.15 * extent.shadow + max(blur, 60 * scene.wavelength_um * scene.f_number) / px + 0.6 * extent.pitch
    half = max(lit, extent.half_cutout + scene.farthest_um / scene.scale / px) + 1.5 * extent.pitch + extent.outward
    side = min(2.1 * round(sampling.samples_per_px or 8) * half, 6000.0)
    orders = tilt_orders(scene, lit * px)
    return int((REFERENCE + (16 * (2 * orders + 6) if orders > 1 else 0)) * side**2 + REFERENCE_CACHE_BYTES)


def _debye_bytes(scene: Scene, sampling: Sampling) -> int:
    from lfcal.simulate.engines import DEBYE_CACHE_BYTES, MARGIN_PER_NODE, MOST_ROWS, highest_order, reach_um

    if not is_separable(scene):
        margin = max(sampling.margin_px, MARGIN_PER_NODE * sampling.nodes_per_px)
        return _window_bytes(scene, replace(sampling, margin_px=margin))
    cone = 1 / (2 * scene.f_number)
    half = reach_um(scene, sampling)[0] + scene.lattice.pitch_um / 2
    samples = half * 2.4 * cone / scene.wavelength_um + 3
    nodes = max(scene.cutout) * sampling.nodes_per_px + 2
    fields = _fields(scene)
    phases = sum(scene.period) if scene.offsets_um is None else 2 * math.prod(scene.period)
    matrices = 24 * nodes * samples * phases
    # of two factors, each with about half the columns
    carried = 24 * nodes * samples * phases * fields
    quarters = (12 * fields + 64) * samples**2
    orders = 2 * highest_order(
        scene.lattice.pitch_um**2 / (scene.wavelength_um * scene.lattice.types[0].focal_length_um),
        sampling.nodes_per_px,
    )
    # spectra of the rows of a matrix, and the rows that are kept
    rows = (400 * orders + 460 * nodes + 32 * min(MOST_ROWS, nodes * phases)) * samples
    return int(
        min(matrices, DEBYE_CACHE_BYTES) + min(carried, 2 * DEBYE_CACHE_BYTES) + quarters + rows + 24 * nodes * samples
    )
