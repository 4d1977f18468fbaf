"""Half-cell scans: where half the positions are enough, by the lattice; and where they are not, with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, ScanPlan, preset
from lfcal.camera._half_cell import half_cell


def camera_of(period: tuple[float, float], types: int = 3, kind: str = "hexagonal", **more: float) -> Camera:
    """Return a bench camera whose array has this period ``(y, x)`` in pixels."""
    camera = preset("bench")
    pixel = camera.sensor.pixel_um
    pitch = period[1] * pixel / (types if kind == "hexagonal" else 1)
    row = period[0] * pixel / (2 if kind == "hexagonal" else 1)
    kinds = tuple(LensType(f) for f in (580.8, 435.6, 363.0)[:types])
    lattice = replace(camera.lattice, kind=kind, pitch_um=pitch, row_pitch_um=row, types=kinds, clear_um=None, **more)
    return replace(camera, lattice=lattice, sensor=replace(camera.sensor, shape=(160, 160)))


def plan_of(camera: Camera, **more: object) -> ScanPlan:
    return ScanPlan.for_camera(camera, virtual_depths=[3.0], cutout=31, **more)  # type: ignore[arg-type]


def same_lattice(lattice: LensletLattice, shift_um: np.ndarray) -> bool:
    """Return whether every lenslet, moved by (x, y), falls on one of its type: by looking, not by indices."""
    centres, types = lattice.lenslets_within(300.0, 300.0)
    wide, wide_types = lattice.lenslets_within(900.0, 900.0)
    for centre, kind in zip(centres + shift_um, types, strict=True):
        away = np.hypot(*(wide - centre).T)
        if away.min() > 1.0 or wide_types[int(away.argmin())] != kind:
            return False
    return True


@pytest.mark.parametrize(
    ("types", "period"), [(3, (20.0, 34.0)), (3, (20.06, 34.04)), (1, (12.0, 20.0)), (1, (20.0, 12.0))]
)
@pytest.mark.parametrize("step", [1, 2])
def test_half_a_hexagonal_period_is_a_period(types: int, period: tuple[float, float], step: int) -> None:
    camera = camera_of(period, types)
    plan = plan_of(replace(camera, lattice=replace(camera.lattice, type_step=step)))
    found = half_cell(plan)
    ny, nx = plan.period
    assert found.shift == (ny // 2, nx // 2) and np.abs(found.residual_px).max() <= 0.05
    np.testing.assert_allclose(found.residual_px, np.array(period) / 2 - found.shift, atol=1e-9)
    pixel = camera.sensor.pixel_um
    assert same_lattice(plan.camera.lattice, np.array([nx / 2, ny / 2]) * pixel)
    assert same_lattice(plan.camera.lattice, np.array([-nx / 2, ny / 2]) * pixel)
    half = found.half(plan)
    assert len(half) == ny * nx // 2
    both = np.concatenate([half, found.partners(half)])
    assert len(np.unique(both, axis=0)) == ny * nx and (found.partners(found.partners(half)) == half).all()


def test_a_period_of_two_cells_is_halved_into_cells() -> None:
    plan = plan_of(camera_of((10.0, 18.0), 3))
    twice = replace(plan, period=(20, 36))
    assert half_cell(twice).shift == (10, 18)
    # one cell longer along x alone: half of it is no vector of the lattice
    with pytest.raises(InputError, match="a lenslet half a period from each"):
        half_cell(replace(plan, period=(10, 36)))


def test_a_turned_array_counts_with_its_turn() -> None:
    camera = camera_of((20.0, 34.0))
    small = plan_of(replace(camera, lattice=replace(camera.lattice, rotation_rad=0.0015)))
    assert 0.01 < max(map(abs, half_cell(small).residual_px)) < 0.05
    with pytest.raises(InputError, match=r"within 0\.05 px of whole pixels"):
        half_cell(plan_of(replace(camera, lattice=replace(camera.lattice, rotation_rad=0.006))))


@pytest.mark.parametrize(
    ("camera", "what"),
    [
        (preset("r29"), "even numbers of pixels, got 55 x 95: half of it lies half a pixel off"),
        (preset("bench"), "got 19 x 33"),
        (camera_of((20.2, 34.0)), r"within 0\.05 px of whole pixels, got \+0\.100 rows"),
        (camera_of((20.0, 34.24)), r"\+0\.120 columns off"),
        (camera_of((20.0, 20.0), 1, "square"), "a lenslet half a period from each"),
    ],
)
def test_where_half_is_not_enough(camera: Camera, what: str) -> None:
    plan = ScanPlan.for_camera(camera, virtual_depths=[3.0], cutout=31)
    with pytest.raises(InputError, match=what):
        half_cell(plan)


def test_types_that_differ_and_resampled_frames_are_refused() -> None:
    # six lenslets along the row: half of them is the next type's place in the next row
    plan = plan_of(camera_of((20.0, 34.0)))
    with pytest.raises(InputError, match="frames to be resampled"):
        half_cell(replace(plan, resample=True))
    # a period of one lenslet, as of an array of one type: the type half a period away is another one
    one = replace(plan_of(camera_of((20.0, 36.0))), period=(20, 12))
    with pytest.raises(InputError, match="lenslets of the same type half a period away, got another type"):
        half_cell(one)
