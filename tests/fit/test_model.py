"""Predictions are those of the simulator, with each source where it was."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from lfcal.fit.model import LEVEL, Fineness, predict
from lfcal.simulate.accuracy.sampling import grid_margin
from lfcal.simulate.effects import Crosstalk, FiniteSource
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import scene_for
from tests.cli.test_fit_units import two_planes
from tests.fit.common import setup_of, small_plan, some_index, vector_of
from tests.simulate.common import difference

PLAN = small_plan()
INDEX = some_index(PLAN, 6)
STILL = np.zeros((6, 2))


@pytest.mark.parametrize("more", [(), (Crosstalk(0.03),), (FiniteSource(30.0), Crosstalk(0.02))])
def test_predictions_are_the_simulator_s(more: tuple[object, ...]) -> None:
    setup = replace(setup_of(PLAN), effects=(*setup_of(PLAN).effects, *more))  # type: ignore[arg-type]
    found = predict(setup, PLAN, INDEX[:2], STILL[:2], Fineness.fine)
    for k, (z, y, x) in enumerate(INDEX[:2].tolist()):
        wanted = PlaneResponse(PLAN, z, setup.effects, level=LEVEL, sampling=Fineness.fine).rows([y], [x])[0, 0]
        # the grids are not of one size
        assert difference(found[k], wanted) < 5e-3


@pytest.mark.long
def test_the_grid_is_as_fine_as_is_said() -> None:
    """Against the coherent reference, which shares no sampling with the grid."""
    setup = setup_of(PLAN)
    own = INDEX[INDEX[:, 0] == 0][:2]
    reference = np.stack(
        [
            PlaneResponse(PLAN, 0, setup.effects, level="reference", sampling=Sampling(10.0)).rows([y], [x])[0, 0]
            for _, y, x in own.tolist()
        ]
    ).astype(float)
    for sampling, least in ((Fineness.coarse, 6e-3), (Fineness.fine, 1.2e-3), (Fineness.finest, 6e-4)):
        found = predict(setup, PLAN, own, np.zeros((2, 2)), sampling)
        assert np.sqrt(np.square(found - reference).sum() / np.square(reference).sum()) < least


def test_displaced_sources_are_computed_where_they_are() -> None:
    """Also of one position measured twice; of the margins that a fit's grids have."""
    setup = setup_of(PLAN)
    index = np.array([[0, 4, 7], [1, 4, 7], [0, 4, 7]])
    moved = np.array([[0.2, -0.1], [0.0, 0.3], [-0.4, 0.25]])
    found = predict(setup, PLAN, index, moved, Fineness.fine)
    pixel = PLAN.camera.sensor.pixel_um
    for k in range(3):
        scene = scene_for(PLAN, int(index[k, 0]), setup.effects)
        offsets = np.broadcast_to(moved[k] * pixel, (*scene.period, 2))
        wide = replace(Fineness.fine, margin_px=grid_margin(scene, 0.006))
        wanted = engine_for(replace(scene, offsets_um=offsets), LEVEL, wide).rows([4], [7])[0, 0]
        assert difference(found[k], wanted) < 2e-3
    assert difference(found[0], found[2]) > 0.1


def test_longer_steps_of_the_stage_grow_from_the_period_s_middle() -> None:
    setup = setup_of(PLAN)
    longer = replace(setup, stage_scale=0.02)
    middle = (np.array(PLAN.period) - 1) / 2
    moved = 0.02 * (INDEX[:, 1:] - middle)
    found = predict(longer, PLAN, INDEX, STILL, Fineness.fine)
    np.testing.assert_allclose(found, predict(setup, PLAN, INDEX, moved, Fineness.fine), atol=1e-6 * found.max())


def test_predictions_are_smooth_in_every_unknown() -> None:
    """Half a step to the side changes half as much: derivatives are no artefact of a grid that jumps."""
    vector = vector_of(PLAN, ("geometry", "focal_lengths", "lenslet_spherical", "iris", "wavefront", "crosstalk"))
    base = predict(vector.setup, PLAN, INDEX, STILL, Fineness.coarse).astype(float)
    for k, one in enumerate(vector.unknowns):
        changes = []
        for step in (0.1, 0.05):
            u = np.zeros(len(vector))
            u[k] = step
            changes.append((predict(vector.setup_at(u), PLAN, INDEX, STILL, Fineness.coarse) - base) / step)
        assert difference(changes[0], changes[1]) < 0.06, one.name


@pytest.mark.parametrize(("depth", "cutout", "least"), [(0.0, 21, 4e-3), (2.2, 29, 1.5e-3), (3.5, 15, 1.5e-3)])
@pytest.mark.few(1)
def test_the_light_beyond_the_shadow_is_all_there(depth: float, cutout: int, least: float) -> None:
    """A grid that ends five pixels beyond it is 1 % off near the native plane, 0.2-0.3 % elsewhere, however fine."""
    plan = small_plan(cutout, (depth,))
    setup = setup_of(plan)
    at = np.array([[0, 3, 5]])
    found = predict(setup, plan, at, np.zeros((1, 2)), Fineness.finest)[0]
    response = PlaneResponse(plan, 0, setup.effects, level="reference", sampling=Sampling(8.0 if depth == 0 else 12.0))
    assert difference(found, response.rows([3], [5])[0, 0]) < least


def test_a_plane_made_alone_reports_its_own_rows() -> None:
    fit = two_planes()
    planes, ny = fit.planes(), fit.planned.period[0]
    zeros = partial(np.zeros, planes.header.shape[1:], np.float32)
    for alone, stage, first, total in ((True, "model plane 1", 0, ny), (False, "model", ny, 2 * ny)):
        records = list(planes.iter_plane(1, zeros, 1, alone=alone))
        assert [one.done for one in records] == list(range(first, first + ny + 1))
        assert {(one.stage, one.total) for one in records} == {(stage, total)}
