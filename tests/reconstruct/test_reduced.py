"""H within a tolerance: what is left out is bounded position by position, and the pair stays exactly adjoint."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors._reduced import Reduced
from lfcal.reconstruct.projectors._reduction import AxisNodes, quickest_spacing, reduce_plane, sampled_share
from lfcal.reconstruct.projectors.grid import Grid
from tests.reconstruct.oracles import dense, lenslet_psf

DOUBLE = np.dtype(np.float64)


def slow_psf(period=(9, 10), cutout=(15, 13), *, noise=0.0, signed=False):
    """Return one plane of a spot that hardly moves over weak light that changes slowly, ``(1, ny, nx, nt, ns)``."""
    rng = np.random.default_rng(5)
    t, s = (np.arange(n) - n // 2 for n in cutout)
    H = np.empty((1, *period, *cutout))
    for y in range(period[0]):
        for x in range(period[1]):
            # where things are on the sensor, seen from a cutout that moves along
            down, across = t[:, None] + 0.75 * y - 3, s[None, :] + 0.75 * x - 3
            far = 1 / (20 + down**2 + across**2)
            H[0, y, x] = np.exp(-(down**2 + across**2)) + far * (np.cos(across / 4) if signed else 1)
    H *= 1 + noise * rng.standard_normal(H.shape)
    return H


def engine(H, image, anchor=(0, 0), tolerance=0.05, *, spacing=None, phases=None, workers=2):
    """Return an engine that takes nodes as far apart as they can be, or those ``spacing`` apart."""
    grid = Grid(image, H.shape[1:3], H.shape[3:], anchor)
    work = (lambda g, kept: 1 / g) if spacing is None else (lambda g, kept: abs(g - spacing) if g > 1 else 99.0)
    return Reduced(grid, DOUBLE, workers, phases, tolerance=tolerance, work=work)


def matrix_of(reduced, H, image):
    """Return forward and adjoint projection as matrices, by unit volumes and images."""
    operand = reduced.prepare(H[0])
    units = np.eye(image[0] * image[1]).reshape(-1, *image)
    ahead = np.stack([reduced.forward([(operand, unit)]).ravel() for unit in units], axis=1)
    back = np.stack([next(reduced.adjoint(unit, [operand])).ravel() for unit in units], axis=1)
    return operand, ahead, back


@pytest.mark.parametrize("anchor", [(0, 0), (-4, 3)])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.few(1)
def test_the_error_of_each_voxel_is_within_the_tolerance_and_the_pair_is_transposed(anchor, signed):
    H, image, tolerance = slow_psf(signed=signed), (21, 14), 0.05
    operand, ahead, back = matrix_of(engine(H, image, anchor, tolerance), H, image)
    assert operand.rest is not None
    assert operand.spacing > 2
    assert np.abs(ahead - back.T).max() <= 1e-14
    truth = dense(H, image, anchor)
    lacking = np.abs(ahead - truth).sum(axis=0).reshape(image)
    whole = np.abs(H[0]).sum(axis=(2, 3))
    rows, columns = ((np.arange(n) - a) % p for n, a, p in zip(image, anchor, H.shape[1:3], strict=True))
    assert (lacking <= tolerance * whole[np.ix_(rows, columns)] * (1 + 1e-12)).all()
    assert lacking.max() > 0.2 * tolerance * whole.min()  # it does leave something out


def test_the_error_of_nonnegative_volumes_is_within_the_bound():
    H, rng = lenslet_psf(nz=2, period=9, cutout=31), np.random.default_rng(0)
    image = (60, 61)
    exact = Projector(H, image, method="direct", dtype=np.float64)
    within = Projector(H, image, method="reduced", tolerance=0.01, dtype=np.float64)
    for g in (rng.random(exact.volume_shape), (rng.random(exact.volume_shape) > 0.99).astype(float)):
        missed = np.abs(within.forward(g) - exact.forward(g)).sum()
        assert missed <= 0.01 * (g * np.abs(H).sum(axis=(3, 4)).max(axis=(1, 2))[:, None, None]).sum()


@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    image=st.tuples(st.integers(1, 25), st.integers(1, 25)),
    period=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    half=st.tuples(st.integers(0, 5), st.integers(0, 5)),
    anchor=st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    tolerance=st.sampled_from([0.001, 0.03, 0.3]),
)
def test_forward_and_adjoint_have_equal_inner_products(image, period, half, anchor, tolerance):
    rng = np.random.default_rng(image[0] + 31 * image[1])
    H = slow_psf(period, (2 * half[0] + 1, 2 * half[1] + 1), noise=0.01)
    reduced = engine(H, image, anchor, tolerance)
    operand = reduced.prepare(H[0])
    g, f = rng.standard_normal(image), rng.standard_normal(image)
    Hg, Hf = reduced.forward([(operand, g)]), next(reduced.adjoint(f, [operand]))
    size = np.linalg.norm(Hg) * np.linalg.norm(f) + np.linalg.norm(g) * np.linalg.norm(Hf)
    assert abs(np.vdot(Hg, f) - np.vdot(g, Hf)) <= 1e-12 * max(size, 1e-300)


def test_a_tighter_tolerance_keeps_more():
    (plane,) = slow_psf()
    found = [reduce_plane(plane, 3.0, tolerance) for tolerance in (0.1, 0.03, 0.01, 0.003, 0.0)]
    assert [one.kept for one in found] == sorted(one.kept for one in found)
    wide = np.pad(plane, ((0, 0), (0, 0), (2, 2), (3, 3)))  # nodes lie 3, and 3 and 4 positions apart
    assert found[0].plane().shape == wide.shape
    for one, tolerance in zip(found[:4], (0.1, 0.03, 0.01, 0.003), strict=True):
        assert one.error.max() <= tolerance
        lacking = np.abs(one.plane() - wide).sum(axis=(2, 3)) / np.abs(plane).sum(axis=(2, 3))
        assert np.allclose(lacking, one.error, rtol=0, atol=1e-12)
    assert np.allclose(found[4].plane(), wide, rtol=0, atol=1e-15)


def test_positions_at_nodes_need_no_entries_and_threads_change_nothing():
    (plane,) = slow_psf()
    found, three = (reduce_plane(plane, 3.0, 0.01, workers) for workers in (1, 3))
    assert (found.rest == three.rest).all() and (found.error == three.error).all()
    assert found.kept > 0
    assert not found.rest[np.ix_(found.nodes.y.at, found.nodes.x.at)].any()
    assert (found.patterns == plane[np.ix_(found.nodes.y.at, found.nodes.x.at)]).all()


def test_positions_without_light_stay_without_light():
    H = slow_psf()
    H[0, 4, 5] = 0
    reduced = engine(H, (18, 20), spacing=2.0)
    operand = reduced.prepare(H[0])
    dark = np.zeros((18, 20))
    dark[4, 5] = dark[13, 15] = 1
    assert np.abs(reduced.forward([(operand, dark)])).max() <= 1e-15
    assert np.abs(reduced.forward([(operand, np.roll(dark, 1, axis=0))])).max() > 0.1
    assert operand.error <= 0.05


def test_the_quickest_spacing_is_chosen():
    assert quickest_spacing({2.0: 0.02, 4.0: 0.06, 8.0: 0.2}) == 4.0
    assert quickest_spacing({2.0: 0.4, 4.0: 0.5}) == 1.0
    assert quickest_spacing({}) == 1.0


def test_noise_is_projected_whole():
    H = np.random.default_rng(0).random((1, 9, 10, 15, 13))
    P = Projector(H, (40, 41), method="reduced", tolerance=0.005, dtype=np.float64)
    g = np.random.default_rng(1).random(P.volume_shape)
    exact = Projector(H, (40, 41), method="direct", dtype=np.float64)
    assert np.allclose(P.forward(g), exact.forward(g), rtol=1e-12)
    assert np.allclose(P.adjoint(g[0]), exact.adjoint(g[0]), rtol=1e-12)


@pytest.mark.parametrize("workers", [1, 3])
def test_chosen_phases_are_the_masked_operator(workers):
    H, image = slow_psf(), (25, 27)
    rng = np.random.default_rng(2)
    mask = rng.random(H.shape[1:3]) < 0.4
    whole, some = engine(H, image, spacing=3.0), engine(H, image, spacing=3.0, phases=mask, workers=workers)
    g, f = rng.random(image), rng.random(image)
    seen = whole.grid.tiled(mask)
    all_of_it, part = whole.prepare(H[0]), some.prepare(H[0])
    assert np.allclose(some.forward([(part, g)]), seen * whole.forward([(all_of_it, g)]), rtol=0, atol=1e-12)
    ahead, back = next(some.adjoint(f, [part])), next(whole.adjoint(seen * f, [all_of_it]))
    assert np.allclose(ahead, back, rtol=0, atol=1e-12)


def test_a_sample_of_positions_predicts_what_all_keep():
    (plane,) = slow_psf((20, 21))
    found = sampled_share(lambda y, x: plane[y, x], (20, 21), 4.0, 0.02, samples=60)
    assert found == pytest.approx(reduce_plane(plane, 4.0, 0.02).kept / plane.size, rel=0.2)


def test_nodes_of_an_axis():
    for period, spacing in ((1, 3.0), (7, 1.0), (7, 2.0), (10, 3.0), (10, 40.0), (95, 4.0)):
        nodes = AxisNodes(period, spacing)
        assert nodes.at[0] == 0 and (np.diff(np.append(nodes.at, period)) >= 1).all()
        assert ((nodes.weight >= 0) & (nodes.weight < 1)).all()
        # positions are those that their nodes state, in this period and the next
        straight = np.append(nodes.at, period)
        between = straight[nodes.before] * (1 - nodes.weight) + straight[nodes.before + 1] * nodes.weight
        assert np.allclose(between, np.arange(period), atol=1e-12)


def test_wrong_tolerances_are_refused():
    for arguments, message in (
        ({"method": "reduced"}, "expected a tolerance above 0"),
        ({"tolerance": -0.1}, "tolerance of the projection: expected a number ≥ 0"),
        ({"tolerance": 1.0}, "tolerance of the projection"),
        ({"tolerance": float("nan")}, "tolerance of the projection"),
    ):
        with pytest.raises(InputError, match=message):
            Projector(slow_psf(), (20, 20), **arguments)
