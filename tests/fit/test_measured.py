"""What is read of an H, and what is not fit for a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.fit.measured import measured_of
from lfcal.fit.spread import held_out_rows, spread_out
from lfcal.psf import PSFMatrix
from lfcal.psf.facts import Facts, pack_valid
from tests.fit.common import small_camera, small_plan

PLAN = small_plan(5, (2.2, 2.7))
RNG = np.random.default_rng(3)


def matrix(recorded: np.ndarray | None = None, **facts: object) -> PSFMatrix:
    shape = PLAN.shape
    values = np.random.default_rng(4).normal(10, 1, shape).astype(np.float32)
    known = {"recorded": np.ones(shape[:3]) if recorded is None else recorded, **facts}
    return PSFMatrix(
        values,
        depths=PLAN.depths_um,
        camera=PLAN.camera,
        anchor=PLAN.anchor,
        facts=Facts.of(shape[:3], shape[3:], **known),  # type: ignore[arg-type]
    )


def test_only_recorded_positions_are_taken() -> None:
    recorded = np.zeros(PLAN.shape[:3])
    places = [(0, 3, 5), (0, 17, 30), (1, 0, 0), (1, 9, 12), (1, 18, 32)]
    for place in places:
        recorded[place] = 2
    source = matrix(recorded)
    found = measured_of(source, noise=(4.0, 1.0))
    assert [tuple(one) for one in found.index.tolist()] == places
    for k, place in enumerate(places):
        assert (found.patterns[k] == source[place]).all()
    assert found.held_out.sum() == 1 and found.plan == replace(PLAN, exposure_s=found.plan.exposure_s)
    assert (found.noise == [4.0, 1.0]).all()
    ((plan, own, part),) = found.parts()
    assert (plan, own.tolist(), part) == (found.plan, [0, 1, 2, 3, 4], 0), "one region, which is the first"


def test_noise_and_masks_are_read_from_h() -> None:
    noise = np.stack([RNG.uniform(1, 2, PLAN.shape[:3]), RNG.uniform(0, 1, PLAN.shape[:3])], -1)
    valid = RNG.random(PLAN.shape) > 0.1
    found = measured_of(matrix(noise=noise, valid=pack_valid(valid)), most=12)
    assert len(found) == 12
    np.testing.assert_allclose(found.noise, noise[tuple(found.index.T)].astype(np.float32))
    assert (found.valid == valid[tuple(found.index.T)]).all()


def test_a_smaller_cutout_is_the_middle() -> None:
    source = matrix()
    found = measured_of(source, noise=(1.0, 0.0), cutout=3, positions=[(0, 1, 2), (1, 3, 4), (0, 5, 6)])
    assert found.plan.cutout == (3, 3) and (found.patterns[0] == source[0, 1, 2][1:4, 1:4]).all()


def test_unusable_patterns_are_refused() -> None:
    H, noise = matrix(), {"noise": (1.0, 0.0)}
    for source, options, what in (
        (H, {}, "noise of H: expected a variance model, got none"),
        (H, {"noise": (0.0, 0.0)}, "noise of the patterns: expected a variance above 0"),
        (H, {"noise": (-1.0, 0.0)}, "noise: constant"),
        (H, {**noise, "cutout": 4}, "an odd number, got 4"),
        (H, {**noise, "cutout": 7}, "cutout"),
        (H, {**noise, "held_out": 1.0}, "held-out patterns"),
        (H, {**noise, "positions": [(0, 0, 0), (0, 1, 1)]}, "at least 3, got 2"),
        (H, {**noise, "positions": [(0, 0, 0), (0, 1, 1), (2, 0, 0)]}, r"position \(z, y, x\): expected .* inside"),
        (H.T, noise, "those of H, got those of HT"),
        (PSFMatrix(np.ones((1, 2, 2, 3, 3))), noise, "camera of H: expected a description"),
    ):
        with pytest.raises(InputError, match=what):
            measured_of(source, **options)  # type: ignore[arg-type]


def test_nan_is_refused_unless_masked() -> None:
    source = matrix()
    found = measured_of(source, noise=(1.0, 0.0), most=6)
    patterns = found.patterns.copy()
    patterns[2, 1, 1] = np.nan
    with pytest.raises(InputError, match="finite values"):
        replace(found, patterns=patterns)
    valid = found.valid.copy()
    valid[2, 1, 1] = False
    assert len(replace(found, patterns=patterns, valid=valid)) == 6


def nearest(steps: np.ndarray) -> float:
    """Return the smallest distance of two different places from all their differences."""
    apart = np.linalg.norm(steps, axis=-1)
    np.fill_diagonal(apart, np.inf)
    return float(apart.min())


def test_positions_are_spread_over_planes_and_period() -> None:
    every = np.argwhere(np.ones((2, 19, 33), bool))
    chosen = every[spread_out(every, 20, (19, 33))]
    assert (np.bincount(chosen[:, 0]) == 10).all() and len(np.unique(chosen, axis=0)) == 20
    for z in (0, 1):
        own = chosen[chosen[:, 0] == z, 1:]
        apart = np.abs(own[:, None] - own[None])
        # ten discs of this distance would fill half of the period
        assert nearest(np.minimum(apart, np.array([19, 33]) - apart)) > 0.6 * np.sqrt(19 * 33 / 10)
    assert len(spread_out(every[:3], 9, (19, 33))) == 3


@pytest.mark.parametrize("name", ["bench", "lfm_20x05"])
def test_held_out_patterns_lie_everywhere_behind_a_lenslet(name: str) -> None:
    """Far apart in the period alone, all four of a plane would have the source at one place of its lenslet."""
    camera = small_camera(name)
    plan = ScanPlan.for_camera(camera, cutout=21, depths_um=[0.0, 5.0])
    every = np.argwhere(np.ones(plan.shape[:3], bool))
    index = every[spread_out(every, 40, plan.period)]
    aside = index[held_out_rows(index, 8, plan)]
    assert (np.bincount(aside[:, 0]) == 4).all() and len(np.unique(aside, axis=0)) == 8
    cell = plan.camera.lattice.basis_um()[:, ::-1] / plan.camera.sensor.pixel_um
    for z in (0, 1):
        own = aside[aside[:, 0] == z, 1:]
        steps = (own[:, None] - own[None]) @ np.linalg.inv(cell)
        # four discs of this distance would fill a quarter of the cell
        assert nearest((steps - np.rint(steps)) @ cell) > 0.5 * np.sqrt(abs(np.linalg.det(cell)) / 4)
