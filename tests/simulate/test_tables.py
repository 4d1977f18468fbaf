"""Tables of the wave engine: how far light reaches, and what they take while they are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lfcal.camera import LensletLattice, LensType
from lfcal.simulate.engines import tables
from lfcal.simulate.engines._polygon import area, half_planes
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.field import field_table
from lfcal.simulate.engines.tables import build_tables
from lfcal.simulate.scene import PupilIris, Scene
from tests.simulate.common import peak_bytes
from tests.simulate.scenes import camera_scene


@pytest.mark.parametrize("shape", [(30, 30), (31, 31)])
def test_light_reaches_the_farthest_lit_sample(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    for share in (0.003, 0.05, 1.0):
        energy = (rng.random(shape) < share).astype(np.float32)
        rows, columns = np.nonzero(energy)
        middle = shape[0] // 2
        wanted = max((np.hypot(r - middle, c - middle) for r, c in zip(rows, columns, strict=True)), default=-1.0) + 1
        assert tables._lit_radius(energy, 2.0, 0.5) == pytest.approx(2.0 * wanted)


def test_a_list_of_lit_samples_is_not_made() -> None:
    energy = np.ones((1000, 1000), np.float32)
    _, peak = peak_bytes(lambda: tables._lit_radius(energy, 1.0, 0.5))
    assert peak < 4 * energy.size  # two whole numbers for each were 16


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "scene",
    [
        camera_scene(8.0),
        camera_scene(8.0, wavefront=((4, 0, 1.0), (2, 2, 0.5))),
        camera_scene(8.0, iris=PupilIris()),
        camera_scene(0.3),
        camera_scene(0.3, wavefront=((4, 0, 1.0), (2, 2, 0.5))),
    ],
    ids=["E", "E aberrated", "E round", "U", "U aberrated"],
)
def test_a_field_is_made_in_three_times_its_size(scene: Scene) -> None:
    field_table(camera_scene(scene.virtual_depth), 2.0, 60.0)  # compiles what is compiled
    table, peak = peak_bytes(lambda: field_table(scene, 0.8, 500.0))
    assert peak < 3 * table.values.nbytes  # type: ignore[attr-defined]


def test_types_that_sample_alike_share_a_field() -> None:
    made = build_tables(camera_scene(4.0), Sampling(samples_per_px=2.0), "E")
    assert made.kinds[0].field.re is made.kinds[1].field.re is made.kinds[2].field.re


def through_the_array(scene: Scene, source_um: tuple[float, float]) -> float:
    """Return the share of a cone's rays, even over a round shadow, that meet a lenslet's clear disc in its cell."""
    n = np.arange(200_000) + 0.5
    r, angle = scene.shadow_radius_um * np.sqrt(n / n.size), n * np.pi * (3 - np.sqrt(5))
    rays = np.stack([source_um[0] + r * np.cos(angle), source_um[1] + r * np.sin(angle)], axis=1)
    reach = scene.shadow_radius_um + 200.0
    q, p = (v.ravel() for v in np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)))
    centres = scene.lattice.centres_um(q, p)
    centres = centres[(np.abs(centres) < reach).all(1)]
    nearest, _ = cKDTree(centres).query(rays)
    assert scene.lattice.clear_um is not None
    return float((nearest <= scene.lattice.clear_um / 2).mean())


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("kind", "clear"), [("square", 1.41), ("square", 1.2), ("hexagonal", 1.15), ("hexagonal", 1.08)]
)
def test_lenslets_wider_than_their_cells_end_there(kind: str, clear: float) -> None:
    scene = camera_scene(3.0, iris=PupilIris(), cutout=(75, 75), period=(1, 1))
    pitch = scene.lattice.pitch_um
    lattice = replace(scene.lattice, kind=kind, types=(LensType.focused_at(3.0, 412.5),), clear_um=clear * pitch)
    scene = replace(scene, lattice=lattice)
    wanted = through_the_array(scene, (0.0, 0.0))
    rays = float(engine_for(scene, "geometric").rows([0], [0])[0, 0].sum())
    assert rays == pytest.approx(wanted, abs=0.002)  # without the cells 1.3 and more
    waves = [
        float(engine_for(scene, "wave", Sampling(nodes_per_px=5, margin_px=12)).rows([0], [0])[0, 0].sum()),
        float(engine_for(scene, "grid", Sampling(samples_per_px=5)).rows([0], [0])[0, 0].sum()),
        float(engine_for(scene, "reference", Sampling(samples_per_px=5)).rows([0], [0])[0, 0].sum()),
    ]
    assert max(waves[1:]) < 1.0  # windows whose intensities are added err by 2 %
    assert waves == pytest.approx([wanted] * 3, abs=0.02)


@pytest.mark.parametrize(
    ("kind", "row", "clear"),
    [("square", 72.0, 84.0), ("hexagonal", 72.0, 84.0), ("hexagonal", 40.0, 70.0), ("hexagonal", 30.0, 62.0)],
)
@pytest.mark.parametrize("shear", [0.0, 0.05])
def test_discs_wider_than_their_cells_tile_the_plane(kind: str, row: float, clear: float, shear: float) -> None:
    lattice = LensletLattice(
        kind, 80.0, 400.0, (LensType(400.0),), 0.2, row_pitch_um=row, clear_um=clear, shear_rad=shear
    )
    scene = camera_scene(3.0, lattice=lattice)
    assert not scene.gapless and not scene.round_lenslets
    outline = tables.aperture_outline(scene)
    assert area(outline) / (80.0 * row) == pytest.approx(lattice.fill_factor, rel=1e-3)
    places = np.random.default_rng(1).uniform(-120, 120, (4000, 2))
    centres, _ = lattice.lenslets_within(400.0, 400.0)
    away = places[:, None] - centres[None]
    normals, limits = half_planes(outline)
    inside = ((away @ normals.T) <= limits).all(-1)
    assert inside.sum(1).max() == 1
    nearest = np.hypot(*away.transpose(2, 0, 1)).min(1)
    assert (inside.any(1) == (nearest < clear / 2)).mean() > 0.999
    assert scene.fill_factor == lattice.fill_factor
