"""Tables of the wave engine: how far light reaches, and what they take while they are made."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.simulate.engines import tables
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.field import field_table
from lfcal.simulate.engines.tables import build_tables
from lfcal.simulate.scene import Iris, Scene
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
        camera_scene(8.0, iris=Iris()),
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
