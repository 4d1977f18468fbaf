"""Work of the engines, by counts of samples, nodes and lenslets: the time for tables, and for a position.

The times for each were fitted to the engines' tables and positions for the planes of 90 random cameras. The machine
computed `FITTED_RATE` complex multiply-adds per second and thread in small matrix products.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lfcal.camera import LensletLattice, Microscope
from lfcal.simulate._symmetry import axis_phase, is_separable, mirrored_rows
from lfcal.simulate.accuracy.sampling import LevelSampling, grid_extent
from lfcal.simulate.effects import Outlook
from lfcal.simulate.engines import SWITCH, SWITCH_EXACT, Sampling
from lfcal.simulate.scene import PupilIris, Scene

__all__ = ["FITTED_RATE", "SET_UP", "EngineWork", "LightSizes", "Traits", "engine_work"]

FITTED_RATE = 2e10
"""Complex multiply-adds per second of the machine on which the times were measured."""

SET_UP = 1e-3
"""Constant part of the CPU-seconds for the tables of an engine."""

PER_POSITION, PER_SAMPLE, PER_BINNED = 1.2e-5, 1.2e-10, 4.5e-10
"""CPU-seconds of a grid of n x n samples for each position: for itself, for n² log2 n, and for a cutout's samples."""

CACHED_SIDE, BEYOND_CACHE = 512, 1.6
"""Side of a grid that fits into the cache, and the largest ratio of `PER_SAMPLE` beyond it."""

PER_MASK, PER_ROUND_SAMPLE, PER_CELL_SAMPLE, PER_TRANSFER = 1.2e-5, 4.5e-9, 5.3e-8, 1e-8
"""CPU-seconds of a grid's tables: for each lenslet, and for each sample of round lenslets, of cells and of the transfer
function."""

PER_CELL_TABLE = 7e-8
"""CPU-seconds for each sample of the table of a lens type from which the masks of cells are interpolated."""

PER_RADIAL, PER_EDGED, PER_EDGE, PER_SHADOW, PER_ABERRATED = 2.5e-8, 1.75e-8, 8e-10, 1.5e-8, 1e-8
"""CPU-seconds for each sample of a main lens's field: radial, of a polygon, of each edge, of a round shadow, and for
aberrations."""

CURVED_EDGES = 150
"""Approximate number of edges with which a pupil with curved edges is drawn."""

PER_LENSLET, PER_MASKED, PER_NODE, PER_PRODUCT = 5e-6, (2.5e-9, 6e-8), 1.2e-9, 4.3e-11
"""CPU-seconds of windows for each lenslet of a position: for itself, and for each sample, node and multiply-add. The
second time for a sample is divided by the number of positions of a row, which share masks."""

LIT = 0.9
"""Fraction of the lenslets within the reach of the light that are lit."""

FEWEST = 12
"""Smallest number of positions of a row that share masks in the fit."""

PER_FIELD_SAMPLE, COHERENT_NODE = 2.5e-8, 7.5e-9
"""CPU-seconds of windows: for the light of a lenslet at each sample of the field, and for each node of a cutout at
which fields are added."""

PER_DEBYE_TABLE, PER_FACTOR, PER_RADIUS = 9e-4, 2.4e-7, 5.6e-6
"""CPU-seconds of the Debye path's tables: for themselves, and for each sample of a field and along its axis."""

PER_MATRIX, PER_ROW, PER_ORDER, PER_FACTOR_PRODUCT = 1.3e-4, 4.7e-9, 1.1e-9, 2.3e-10
"""CPU-seconds of the Debye path for each matrix, its entries, its entries and orders if phases share no rows, and each
multiply-add of its products with the fields."""

PER_RESPONSE, PER_PLACED, PER_COPIED, PER_DEBYE_PRODUCT = 1.1e-5, 2.7e-6, 4e-10, 3e-11
"""CPU-seconds of the Debye path for each response, each position and its pixels, and each multiply-add of nodes."""

SPARE_RANK = 14
"""Rank of a field on the Debye path beyond its band times its width."""

FAINT_TAIL, FAINT_EDGE = 20, 18
"""Width of the region with all nodes beyond a small shadow, and shadow radius that halves it, in units of lambda N."""

SAME_PLACE = 1e-6
"""Largest difference of a lenslet's pitch from whole pixels at which phases share rows of their matrices (px)."""

MIRRORED = 6
"""Number of positions of a microscope's period for each response that is computed, if the scene is not known."""

DIPOLES = 5
"""Number of fields of a vectorial scene."""


class EngineWork(NamedTuple):
    """CPU-seconds of an engine on the reference machine.

    Attributes
    ----------
    tables
        Time for the tables.
    each
        Time for each position that is computed.
    matrix
        Time for the matrices of a row or column of positions, on the Debye path.
    """

    tables: float
    each: float
    matrix: float = 0.0

    def positions(self, count: float) -> float:
        """Return the CPU-seconds of ``count`` positions of a rectangle that are computed."""
        return count * self.each + min(count, math.sqrt(2 * count)) * self.matrix


@dataclass(frozen=True, slots=True)
class Traits:
    """Properties of a scene, as its effects determine them, on which the work of an engine depends.

    Attributes
    ----------
    separable
        Whether the array acts on rows and columns separately, as the Debye path requires.
    exact
        Whether rays behind the lenslets have exact angles.
    rows
        Fraction of the rows that are computed; the others are mirror images.
    responses
        Fraction of the positions that are computed on the Debye path.
    edges
        Number of edges of the pupil; 0 for a round one.
    aberrated
        Whether the main lens has aberrations, including those of exact angles.
    fields
        Number of fields whose intensities are added.
    """

    separable: bool = True
    exact: bool = False
    rows: float = 1.0
    responses: float = 1 / MIRRORED
    edges: int = 0
    aberrated: bool = False
    fields: int = 1

    @classmethod
    def of(cls, scene: Scene) -> Traits:
        """Return the traits of a scene."""
        ny = scene.period[0]
        separable = scene.objective is not None and is_separable(scene)
        return cls(
            separable,
            scene.exact_rays,
            1 - len(mirrored_rows(scene, np.arange(ny))) / ny,
            _distinct(scene) if separable else 1.0,
            _edges(scene.iris),
            bool(scene.wavefront) or scene.exact_defocus,
            DIPOLES if scene.vectorial else 1,
        )

    def computed(self, level: str) -> float:
        """Return the fraction of a period's positions that are computed at a level."""
        return {"debye": self.responses, "wave": self.rows, "grid": self.rows}.get(level, 1.0)


def _edges(iris: PupilIris) -> int:
    if iris.circular:
        return 0
    return iris.blades if iris.curvature == 0 and iris.stop is None else CURVED_EDGES


def _distinct(scene: Scene) -> float:
    """Return the fraction of a separable scene's positions that have different responses."""
    ny, nx = scene.period
    rows = {axis_phase(scene, 0, scene.source_um(y, 0)[0], y)[0] for y in range(ny)}
    columns = {axis_phase(scene, 1, scene.source_um(0, x)[1], x)[0] for x in range(nx)}
    # the response of swapped phases is the transpose, if pitch and cutout are alike
    alike = next(iter(rows))[2:] == next(iter(columns))[2:]
    pairs = {(min(y, x), max(y, x)) if alike else (y, x) for y in rows for x in columns}
    return len(pairs) / (ny * nx)


def engine_work(described: Scene | Outlook, step: LevelSampling, traits: Traits | None = None) -> EngineWork:
    """Return the CPU-seconds of an engine with one sampling, on the reference machine."""
    if traits is None:
        traits = Traits.of(described) if isinstance(described, Scene) else Traits()
    light = LightSizes.of(described)
    if step.level == "debye":
        return light.debye_work(step.sampling, traits)
    if step.level == "grid":
        return light.grid_work(described, step.sampling, traits)
    return light.window_work(step.sampling, traits)


@dataclass(frozen=True, slots=True)
class LightSizes:
    """Sizes that determine an engine's work: the same for a scene and for the outlook on it."""

    cutout: tuple[int, int]
    period: tuple[int, int]
    pixel_um: float
    wavelength_um: float
    f_number: float
    gap_um: float
    image_um: float
    lattice: LensletLattice
    shadow_px: float
    microscope: bool
    gapless: bool

    @classmethod
    def of(cls, described: Scene | Outlook) -> LightSizes:
        """Return the sizes of a scene in its reduced frame, or of an outlook."""
        shapes, wavelength, f_number = (described.cutout, described.period), described.wavelength_um, described.f_number
        if isinstance(described, Outlook):
            px, gap, image, lattice = described.pixel_um, described.gap_um, described.shift_um, described.camera.lattice
            assert isinstance(lattice, LensletLattice)  # of single lenslets, the engine itself states its cost
            microscope = isinstance(described.camera.optics, Microscope)
            shadow, gapless = described.shadow_px, lattice.gapless
        else:
            px, gap, image = described.reduced_pixel_um, described.reduced_gap_um, described.reduced_image_um
            image = image if abs(image) >= wavelength else math.copysign(wavelength, image)
            shadow = math.hypot(described.shadow_radius_um, 1.22 * wavelength * f_number) / px
            lattice, microscope, gapless = described.lattice, described.objective is not None, described.gapless
        return cls(*shapes, px, wavelength, f_number, gap, image, lattice, shadow, microscope, gapless)

    # -- sizes, in pixels ----------------------------------------------------------------------------------
    @property
    def fringe_px(self) -> float:
        """Width of the fringes at the shadow's edge."""
        return math.sqrt(self.wavelength_um * abs(self.image_um)) / self.pixel_um

    @property
    def cell_px2(self) -> float:
        """Area of a lenslet's cell."""
        return self.lattice.pitch_um * self.lattice.row_step_um / self.pixel_um**2

    @property
    def radius_px(self) -> float:
        """Radius of a lenslet."""
        return self.lattice.clear_diameter_um / 2 / self.pixel_um

    @property
    def spots_px(self) -> tuple[float, ...]:
        """Radius of each type's spot; near the native plane, that of the pupil's image."""
        cone, gap, spots = 1 / (2 * self.f_number), self.gap_um, []
        lit_px = min(self.radius_px, self.shadow_px)
        for kind in self.lattice.types:
            at_infinity = 1 - gap / kind.focal_length_um
            pupil = abs(at_infinity) * self.lattice.clear_diameter_um / 2 + gap * cone
            whole = abs(at_infinity * self.image_um - gap) * cone
            blur = abs(at_infinity - gap / self.image_um) * lit_px
            spots.append(min(blur, pupil / self.pixel_um, whole / self.pixel_um))
        return tuple(spots)

    @property
    def apart(self) -> float:
        """Ratio of the spots' distance to that of their lenslets, 1 - B/a."""
        return abs(1 - self.gap_um / self.image_um) if abs(self.image_um) > 1e-3 * self.gap_um else math.inf

    def per_px(self, half_px: float) -> float:
        """Return the samples per pixel of a lenslet for a window of ``half_px`` (Nyquist), in steps of a half."""
        need = 2 * (half_px + 0.5) * self.pixel_um**2 / (self.wavelength_um * self.gap_um)
        return max(1.0, math.ceil(2 * need) / 2)

    def tail_px(self, floor: float) -> float:
        """Return the distance from the shadow beyond which a lenslet has less than the fraction ``floor`` of light."""
        edge, airy = max(self.shadow_px, self.radius_px), self.wavelength_um * self.f_number / self.pixel_um
        lit = floor * min(1.0, (self.radius_px / edge) ** 2)
        return self.radius_px * math.sqrt(airy / (math.pi**2 * edge * lit))

    def lenslets(self, half_px: float, floor: float) -> float:
        """Return the number of lit lenslets whose windows, ``half_px`` on either side, reach into the cutout."""
        reach = self.shadow_px + max(0.9 * self.tail_px(floor), 1.5 * self.radius_px)
        lit = LIT * math.pi * reach**2 / self.cell_px2
        rows, columns = (n + 2 * half_px + 1 for n in self.cutout)
        return max(1.0, min(lit, rows * columns / max(self.cell_px2 * self.apart**2, 1e-9)))

    # -- work ----------------------------------------------------------------------------------------------
    def grid_work(self, described: Scene | Outlook, sampling: Sampling, traits: Traits) -> EngineWork:
        """Return the work of all lenslets on one grid."""
        per = int(sampling.samples_per_px or 4)
        side = grid_extent(described).side(per, sampling.margin_px)
        samples = math.prod(side + per * n for n in self.period)
        masks = samples * (PER_CELL_SAMPLE if self.gapless else PER_ROUND_SAMPLE)
        masks += PER_MASK * samples / (per**2 * self.cell_px2)
        if self.gapless:
            masks += PER_CELL_TABLE * len(self.lattice.types) * self.cell_table_side(per) ** 2
        field = traits.fields * self._field_seconds(side / per / 2, per, traits)
        beyond = max(1.0, min(BEYOND_CACHE, (side / CACHED_SIDE) ** 0.6))
        each = PER_POSITION + PER_SAMPLE * beyond * side**2 * math.log2(side)
        each += PER_BINNED * math.prod(self.cutout) * per**2
        return EngineWork(SET_UP + masks + field + PER_TRANSFER * side**2, traits.fields * each)

    def cell_table_side(self, per_px: int) -> int:
        """Return the side of the table of a cell, for a grid with ``per_px`` samples per pixel."""
        from lfcal.simulate.engines import RING, bent_fineness  # compiled code: loaded only when it is needed

        corner = self.lattice.pitch_um / math.sqrt(2 if self.lattice.kind == "square" else 3)
        half = math.ceil(per_px * corner / self.pixel_um) + RING + 1
        return 2 * half * bent_fineness(half) + 3

    def _field_seconds(self, half_px: float, per_px: float, traits: Traits) -> float:
        """Return the CPU-seconds of a table of the main lens's field out to ``half_px``."""
        rate = PER_EDGED + PER_EDGE * traits.edges if traits.edges else PER_RADIAL
        fresnel = abs(self.image_um) / (4 * self.f_number**2 * self.wavelength_um)
        if not self.microscope and fresnel >= (SWITCH_EXACT if traits.exact else SWITCH):
            seen = min(self.shadow_px, half_px + 8 * self.fringe_px)
            if not traits.aberrated and self.shadow_px > math.sqrt(2) * (half_px + 8 * self.fringe_px):
                return SET_UP  # even light: no edge of the shadow is near
            reach = max(seen, half_px) + 4 * self.fringe_px
            rate = rate if traits.edges else PER_SHADOW
        elif traits.edges and not self.microscope:
            reach = (half_px + self.shadow_px + 4 * self.fringe_px) / 0.75
        else:
            reach = half_px
        return SET_UP + (rate + PER_ABERRATED * traits.aberrated) * (2 * per_px * reach) ** 2

    def window_work(self, sampling: Sampling, traits: Traits) -> EngineWork:
        """Return the work of windows, from their lenslets, the samples on them, and nodes of windows and cutout."""
        once, shared = PER_MASKED
        masked = once + shared / max(self.period[1], FEWEST)
        each, widest, tables = 0.0, 0, SET_UP
        fields: dict[float, int] = {}
        for spot in self.spots_px:
            half = math.ceil(spot + sampling.margin_px)
            widest = max(widest, half)
            per = self.per_px(half)
            fields[per] = max(fields.get(per, 0), half)
            samples, nodes = 2 * self.radius_px * per + 5, (2 * half + 1) * sampling.nodes_per_px + 2
            products = samples * nodes * (samples + nodes)
            each += masked * samples**2 + PER_NODE * nodes**2 + PER_PRODUCT * products
            if not sampling.coherent:
                tables += self._tail_seconds(half, sampling)
        for per, half in fields.items():
            reach = self._table_reach(half, sampling)
            tables += self._field_seconds(reach, per, traits)
            tables += PER_FIELD_SAMPLE * (2 * per * (max(reach, self.shadow_px) + 4 * self.fringe_px)) ** 2
        lenslets = self.lenslets(widest, sampling.energy_floor)
        position = lenslets * (PER_LENSLET + each / len(self.lattice.types))
        if sampling.coherent:
            position += COHERENT_NODE * math.prod(self.cutout) * sampling.nodes_per_px**2
        return EngineWork(tables, traits.fields * position)

    def _tail_seconds(self, half_px: int, sampling: Sampling) -> float:
        """Return the CPU-seconds of the light of a lens type outside its windows."""
        whole = half_px + min(64, max(20, 8 * sampling.margin_px))
        samples = 2 * self.radius_px * self.per_px(2 * whole) / 2 + 5
        band = self.lattice.clear_diameter_um * self.pixel_um / (self.wavelength_um * self.gap_um)
        nodes = (2 * whole + 1) * max(2, math.ceil(2.2 * band))
        return SET_UP + PER_NODE * nodes**2 + PER_PRODUCT * samples * nodes * (samples + nodes)

    def _table_reach(self, half_px: int, sampling: Sampling) -> float:
        """Return the largest distance from the source's image at which lenslets contribute."""
        lit = 1.15 * self.shadow_px + self.radius_px + self.tail_px(sampling.energy_floor)
        tails = 0 if sampling.coherent else min(64, max(20, 8 * sampling.margin_px))
        shown = math.hypot(*self.cutout) / 2 + 1.5 * half_px + tails + 2
        return min(lit, shown / max(self.apart, 1e-6) + self.radius_px) + self.radius_px

    def debye_work(self, sampling: Sampling, traits: Traits) -> EngineWork:
        """Return the work of rows and columns; that of their matrices is shared by all positions of a period."""
        from lfcal.simulate.engines import highest_order  # compiled code: loaded only when it is needed

        nodes, pitch, cone = sampling.nodes_per_px, self.lattice.pitch_um, 1 / (2 * self.f_number)
        focal = self.lattice.types[0].focal_length_um
        band = cone / self.wavelength_um * self.pixel_um
        per = math.ceil(2.4 * band)
        spill = 1.1 * (self.gap_um * cone + pitch / 2) + 0.5 * max(1, nodes - 1) * pitch
        count = per * (max(self.cutout) / 2 + spill / self.pixel_um) + 1
        rank = min(count, band / per * count + SPARE_RANK)
        rows, columns = (self._debye_nodes(n, nodes) for n in self.cutout)
        orders = 2 * highest_order(pitch**2 / (self.wavelength_um * focal), nodes) + 1
        alike = abs(pitch / self.pixel_um - round(pitch / self.pixel_um)) < SAME_PLACE
        entries = max(rows, columns) * count
        matrix = PER_MATRIX + entries * (PER_ROW + (0 if alike else PER_ORDER * orders))
        matrix += PER_FACTOR_PRODUCT * traits.fields * rank * entries
        placed = (PER_PLACED + PER_COPIED * math.prod(self.cutout)) / traits.responses
        each = PER_RESPONSE + placed + PER_DEBYE_PRODUCT * traits.fields * rows * columns * rank
        tables = PER_DEBYE_TABLE + traits.fields * (PER_FACTOR * count**2 + PER_RADIUS * count)
        return EngineWork(tables, each, matrix)

    def _debye_nodes(self, pixels: int, per_px: int) -> float:
        """Return the nodes along an axis: half as many per pixel where little light falls."""
        airy = self.wavelength_um * self.f_number / self.pixel_um
        tail = FAINT_TAIL * airy / (1 + self.shadow_px / (FAINT_EDGE * airy))
        slope = 1 / (2 * self.f_number) + self.lattice.pitch_um / 2 / abs(self.lattice.types[0].focal_length_um)
        lit = self.shadow_px + tail + 1.1 * slope * self.gap_um / self.pixel_um
        bright = min(pixels, 2 * lit + 1)
        return per_px * bright + math.ceil(per_px / 2) * (pixels - bright) + 4
