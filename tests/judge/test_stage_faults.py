"""Faults of stage, focus and lens types, by patterns whose sources, depths or lenslets are otherwise."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.fit.model import Fineness, PlaneModel
from lfcal.fit.setup import Setup, described_effects
from tests.judge.common import PEAK, Values, clean, compared, faults_of, light, noisy, plan, scaled


@cache
def _scale() -> float:
    return PEAK / float(_patterns(0.0, 0.0).max())


def _patterns(dy: float, dx: float, depth_um: float = 0.0) -> Values:
    """Return the patterns of plane 0 with all sources displaced, or the plane farther away; shares of the light."""
    camera = plan().camera
    setup = Setup(camera, described_effects(camera), (depth_um, 0.0))
    places = np.argwhere(np.ones(plan().period, np.bool_))
    found = PlaneModel(setup, plan(), 0, Fineness.coarse).patterns(places, np.tile((dy, dx), (len(places), 1)))
    return found.reshape(*plan().period, *plan().cutout)


def displaced(dy: NDArray[np.float64], dx: NDArray[np.float64], *, everywhere: bool = False) -> Values:
    """Return a noisy recording, sources of both planes' positions displaced by fields ``(ny, nx)``.

    Only the patterns that are compared are, as no others are looked at; or ``everywhere``.
    """
    camera = plan().camera
    setup = Setup(camera, described_effects(camera), (0.0, 0.0))
    values = light()
    for z in (0, 1):
        own = compared()[compared()[:, 0] == z, 1:]
        places = np.argwhere(np.ones(plan().period, np.bool_)) if everywhere else own
        moved = np.stack([dy[tuple(places.T)], dx[tuple(places.T)]], 1)
        found = PlaneModel(setup, plan(), z, Fineness.coarse).patterns(places, moved)
        values[(z, *places.T)] = found * np.float32(_scale())
    return noisy(values)


def grid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    ny, nx = plan().period
    y, x = np.meshgrid(np.arange(ny) - (ny - 1) / 2, np.arange(nx) - (nx - 1) / 2, indexing="ij")
    return y, x


def test_a_stage_step_is_measured() -> None:
    y, x = grid()
    found = faults_of(displaced(0.03 * y, 0.03 * x))
    assert set(found) == {"stage_axes"} and found["stage_axes"].detail.startswith("stage step +3.0 %:")


def test_a_turned_stage_is_no_lamp() -> None:
    y, x = grid()
    turn = np.radians(1.5)
    found = faults_of(displaced(turn * x, -turn * y))
    assert set(found) == {"stage_axes"} and "stage rotated by" in found["stage_axes"].detail
    assert "1.50" in found["stage_axes"].detail or "1.49" in found["stage_axes"].detail


def test_play_of_the_stage_is_measured() -> None:
    rows = np.arange(plan().period[0]) % 2
    aside = np.where(rows[:, None] == 1, 0.15, -0.15) + np.zeros(plan().period)
    found = faults_of(displaced(0 * aside, aside))
    assert set(found) == {"backlash"} and "+0.30" in found["backlash"].detail


def test_jitter_is_measured() -> None:
    rng = np.random.default_rng(5)
    found = faults_of(displaced(*rng.normal(0, 0.1, (2, *plan().period))))
    assert "jitter" in found and 0.1 < float(found["jitter"].detail.split(" by ")[1].split()[0]) < 0.2
    assert not {"stage_axes", "backlash", "depth_label", "lamp"} & set(found)


def test_swapped_neighbours_are_named_with_their_places() -> None:
    values = clean()
    values[:, :, [3, 4]] = values[:, :, [4, 3]]
    found = faults_of(values)
    assert set(found) == {"strangers"} and found["strangers"].redo
    assert set(found["strangers"].positions[:, 2].tolist()) <= {3, 4}


@pytest.mark.long
def test_a_focus_that_drifts_is_named_with_its_plane() -> None:
    camera, z = plan().camera, plan().depths_um[0]
    ny, _ = plan().period
    moved = camera.depth_of(3.0 * 1.03) - z
    come = (np.arange(ny)[:, None, None, None] + 0.5) / ny
    first, last = _patterns(0.0, 0.0), _patterns(0.0, 0.0, moved)
    values = clean()
    values[0] = noisy(((1 - come) * first + come * last)[None].astype(np.float32) * np.float32(_scale()))[0]
    found = faults_of(values)
    assert "focus_drift" in found and found["focus_drift"].detail.startswith("plane 0")


def test_a_lens_type_of_less_light_is_named() -> None:
    """Each pixel belongs to the lenslet whose centre is nearest, of all of them."""
    camera, values = plan().camera, light()
    _, ny, nx, nt, ns = values.shape
    rows, columns = (plan().anchor[k] - (n - 1) / 2 + np.arange(m) for k, n, m in ((0, nt, ny + nt), (1, ns, nx + ns)))
    points = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), -1))
    middle, span = points.mean((0, 1)), np.ptp(points, (0, 1))
    centres, kinds = camera.lattice.lenslets_within(span[0], span[1], (float(middle[0]), float(middle[1])))
    nearest = np.argmin(np.square(points[:, :, None] - centres).sum(-1), axis=-1)
    found = faults_of(noisy(scaled(values, np.where(kinds[nearest] == 1, 0.8, 1.0).astype(np.float32))))
    assert "type_light" in found and found["type_light"].detail.startswith("type 1 ")
    told = float(found["type_light"].detail.split(" passes ")[1].split(" %")[0])
    assert 76 <= told <= 83, "tails of the other types fall on its pixels"
