"""The compiled kernels at the edges of their blocks: every height, every offset, nothing beyond the ends."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.psf import _kernels, _plane_kernels

Shape = tuple[int, int, int, int, int]
GUARD = 97


def closed_form(H: np.ndarray) -> np.ndarray:
    nz, ny, nx, nt, ns = H.shape
    z, y, x, t, s = np.ogrid[:nz, :ny, :nx, :nt, :ns]
    return H[z, (y + t - nt // 2) % ny, (x + s - ns // 2) % nx, nt - 1 - t, ns - 1 - s]


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a view as the library hands it to the kernels."""
    view = array.view()
    view.flags.writeable = False
    return view


def transpose_into(H: np.ndarray, out: np.ndarray, batch: int, parts: list[int]) -> None:
    source = read_only(H.reshape(-1))
    batches = _kernels.Batches(H.shape, _kernels.source_rows(H.shape), batch)
    for start, stop in itertools.pairwise(parts):
        _kernels.transpose_batches(source, out, batches, _kernels.batch_memory(batches, source.dtype), start, stop)


OTHER_SIZES = [pytest.param(size, marks=pytest.mark.long) for size in (np.uint8, np.uint64)]


@pytest.mark.parametrize("dtype", [np.uint16, np.uint32, *OTHER_SIZES])
@settings(max_examples=40, derandomize=True, deadline=None)
@given(
    shape=st.tuples(
        st.integers(1, 2), st.integers(1, 5), st.integers(1, 35), st.integers(0, 4), st.integers(8, 25)
    ).map(lambda n: (n[0], n[1], n[2], 2 * n[3] + 1, 2 * n[4] + 1)),
    batch=st.integers(1, 9),
    offset=st.integers(0, 70),
    cut=st.floats(0, 1),
)
def test_batches_write_what_they_should_and_no_more(
    dtype: type[np.unsignedinteger], shape: Shape, batch: int, offset: int, cut: float
) -> None:
    H = np.random.default_rng(3).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)
    guarded = np.full(H.size + offset + GUARD, 165, dtype)
    batches = shape[0] * -(-shape[3] // batch)
    transpose_into(H, guarded[offset : offset + H.size], batch, [0, round(cut * batches), batches])
    assert np.array_equal(guarded[offset : offset + H.size].reshape(shape), closed_form(H))
    assert np.all(guarded[:offset] == 165)
    assert np.all(guarded[offset + H.size :] == 165)


@pytest.mark.parametrize("nx", range(1, 50))
def test_every_block_height(nx: int) -> None:
    H = np.arange(3 * nx * 3 * 17, dtype=np.uint32).reshape(1, 3, nx, 3, 17)
    out = np.zeros(H.size, H.dtype)
    transpose_into(H, out, 2, [0, 2])
    assert np.array_equal(out.reshape(H.shape), closed_form(H))


def test_a_part_leaves_the_other_batches_alone() -> None:
    H = np.arange(1, 1 + 3 * 5 * 9 * 21, dtype=np.uint16).reshape(1, 3, 5, 9, 21)
    out = np.zeros(H.size, H.dtype)
    transpose_into(H, out, 4, [1, 2])
    written = out.reshape(H.shape)
    assert np.array_equal(written[..., 4:8, :], closed_form(H)[..., 4:8, :])
    assert not written[..., :4, :].any()
    assert not written[..., 8:, :].any()


def test_batches_bound_the_scratch_memory() -> None:
    assert _kernels.batch_rows((1, 11, 11, 111, 111), 4) == 7
    assert _kernels.batch_rows((1, 11, 11, 551, 551), 4) == 4
    assert _kernels.batch_rows((1, 11, 11, 3, 111), 4) == 3
    assert _kernels.batch_rows((1, 11, 11, 111, 111), 2) == 14
    assert _kernels.batch_rows((1, 500, 500, 501, 501), 8) == 1
    rows = _kernels.source_rows((2, 3, 5, 7, 9))
    assert rows[:6].tolist() == [0, 63, 126, 189, 252, 0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint32, np.complex128])
@pytest.mark.parametrize("shape", [(1, 1, 1, 1, 1), (1, 4, 3, 5, 7), (1, 2, 9, 3, 1)])
def test_plain_rows(shape: Shape, dtype: type[np.generic]) -> None:
    H = (np.arange(np.prod(shape)) % 251).reshape(shape).astype(dtype)
    out = np.zeros_like(H)
    for y in range(shape[1]):
        _kernels.transpose_rows(read_only(H[0]), out[0], y, y + 1)
    assert np.array_equal(out, closed_form(H))


@settings(max_examples=30, derandomize=True, deadline=None)
@given(st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(0, 8), st.integers(0, 8)))
def test_gathered_slices(n: tuple[int, int, int, int]) -> None:
    shape = (n[0], n[1], 2 * n[2] + 1, 2 * n[3] + 1)
    plane = np.arange(np.prod(shape), dtype=np.uint32).reshape(shape)
    expected = closed_form(plane[None])[0]
    for y, x in np.ndindex(shape[:2]):
        out = np.zeros(shape[2] * shape[3], plane.dtype)
        _plane_kernels.gather_slice(read_only(plane.reshape(-1)), shape, y, x, out)
        assert np.array_equal(out.reshape(shape[2:]), expected[y, x])


@pytest.mark.parametrize("n", [1, 7, 8, 9, 40])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32, np.float64])
def test_added_patterns(n: int, dtype: type[np.generic]) -> None:
    rng = np.random.default_rng(n)
    patterns = (rng.random((n, 23)) * 10.0 ** rng.integers(0, 4, (n, 23))).astype(dtype)
    total = np.zeros(23)
    for start, stop in ((0, 5), (5, 5), (5, 23)):
        _plane_kernels.add_patterns(read_only(patterns), total, start, stop)
    exact = np.array([math.fsum(column.astype(float)) for column in patterns.T])
    assert np.all(np.abs(total - exact) <= n * 2.0**-53 * exact)
