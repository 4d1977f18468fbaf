"""HT against a dense projection matrix, the adjoint, the paper's own loop, every kind of array, and its kernels."""

from __future__ import annotations

import itertools
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.psf import PSFMatrix, _kernels, transpose
from lfcal.psf._transpose import border_energy, border_warning, depth_sum, ht_slice

Shape = tuple[int, int, int, int, int]


def closed_form(H: np.ndarray) -> np.ndarray:
    nz, ny, nx, nt, ns = H.shape
    z, y, x, t, s = np.ogrid[:nz, :ny, :nx, :nt, :ns]
    return H[z, (y + t - nt // 2) % ny, (x + s - ns // 2) % nx, nt - 1 - t, ns - 1 - s]


def dense_projection(plane: np.ndarray, image: tuple[int, int]) -> np.ndarray:
    """Return A (pixels, voxels) of the tiled system: voxel v puts H[v mod n] around pixel v, zero outside."""
    ny, nx, nt, ns = plane.shape
    ct, cs = nt // 2, ns // 2
    dense = np.zeros((*image, *image), plane.dtype)
    for row in range(image[0]):
        for column in range(image[1]):
            canvas = np.zeros((image[0] + 2 * ct, image[1] + 2 * cs), plane.dtype)
            canvas[row : row + nt, column : column + ns] = plane[row % ny, column % nx]
            dense[:, :, row, column] = canvas[ct : ct + image[0], cs : cs + image[1]]
    return dense.reshape(image[0] * image[1], -1)


def dense_transpose(H: np.ndarray) -> np.ndarray:
    """Return HT read out of the transposed dense matrix, far enough from the image border for all of it."""
    nz, ny, nx, nt, ns = H.shape
    ct, cs = nt // 2, ns // 2
    margin = -(-ct // ny) * ny, -(-cs // nx) * nx
    image = ny + 2 * margin[0], nx + 2 * margin[1]
    HT = np.zeros_like(H)
    for z in range(nz):
        back = dense_projection(H[z], image).T.reshape(*image, *image)  # (voxel, pixel)
        for y in range(ny):
            for x in range(nx):
                row, column = y + margin[0], x + margin[1]
                HT[z, y, x] = back[row - ct : row + ct + 1, column - cs : column + cs + 1, row, column]
    return HT


def paper_loop(H: np.ndarray) -> np.ndarray:
    """Return HT by figure 9 and equations 3 to 9 of the paper, literally, with its 1-based indices."""
    ny, nx, nt, ns = H.shape[1:]
    source = H.transpose(4, 3, 2, 1, 0)  # H(i, j, m, n, k)
    HT = np.zeros_like(source)

    def wrapped(alpha: int, n: int) -> int:  # equation 5
        if alpha > n:
            return alpha - (alpha - 1) // n * n
        if alpha <= 0:
            return alpha + -(-(1 - alpha) // n) * n
        return alpha

    for i in range(1, ns + 1):
        i_ = ns - i + ns % 2  # equation 8
        for m in range(1, nx + (ns - nx) + 1):
            alpha = m - (ns - nx) // 2  # equation 4
            M = wrapped(alpha, nx)
            m_ = i - nx + alpha + (nx - 1) // 2 - (ns - nx) // 2  # equation 6
            for j in range(1, nt + 1):
                j_ = nt - j + nt % 2  # equation 9
                for n in range(1, ny + (nt - ny) + 1):
                    beta = n - (nt - ny) // 2
                    N = wrapped(beta, ny)
                    n_ = j - ny + beta + (ny - 1) // 2 - (nt - ny) // 2  # equation 7
                    if 0 < m_ <= nx and 0 < n_ <= ny and i_ > 0 and j_ > 0:
                        HT[i_ - 1, j_ - 1, m_ - 1, n_ - 1, :] = source[i - 1, j - 1, M - 1, N - 1, :]
    return HT.transpose(4, 3, 2, 1, 0)


def numbered(shape: Shape, dtype: str = "i8") -> np.ndarray:
    """Return an array in which every entry is another number."""
    return np.random.default_rng(5).permutation(int(np.prod(shape))).reshape(shape).astype(dtype)


def odd(top: int, bottom: int = 0) -> st.SearchStrategy[int]:
    return st.integers(bottom, (top - 1) // 2).map(lambda k: 2 * k + 1)


small = st.tuples(st.integers(1, 2), st.integers(1, 6), st.integers(1, 6), odd(9), odd(9))
wide = st.tuples(st.just(1), st.integers(1, 2), st.integers(1, 37), odd(3), odd(41, 8))


@settings(max_examples=40, derandomize=True, deadline=None)
@given(st.one_of(small, wide))
def test_equals_the_dense_transpose_and_is_its_own_inverse(shape: Shape) -> None:
    H = numbered(shape, "i4")
    HT = transpose(H)
    assert np.array_equal(HT, dense_transpose(H))
    assert np.array_equal(transpose(HT), H)
    assert np.array_equal(HT.sum(axis=(1, 2)), H.sum(axis=(1, 2))[:, ::-1, ::-1]), "depth sums are rotated"


@pytest.mark.parametrize(
    "shape",
    [*((1, 3, 3, 5, 5), (2, 4, 7, 9, 5), (1, 11, 6, 3, 7)), pytest.param((1, 2, 5, 7, 21), marks=pytest.mark.long)],
)
def test_is_the_adjoint(shape: Shape) -> None:
    rng = np.random.default_rng(2)
    H = rng.standard_normal(shape)
    HT = transpose(H)
    image = (23, 29)
    g, f = rng.standard_normal((shape[0], *image)), rng.standard_normal(image)
    forward = sum(dense_projection(H[z], image) @ g[z].ravel() for z in range(shape[0]))
    back = np.array([dense_projection(HT[z], image) @ f.ravel() for z in range(shape[0])])
    scale = np.linalg.norm(forward) * np.linalg.norm(f)
    assert abs(forward @ f.ravel() - back.ravel() @ g.ravel()) < 1e-12 * scale
    flipped = np.array([dense_projection(HT[z, :, :, ::-1], image) @ f.ravel() for z in range(shape[0])])
    assert abs(forward @ f.ravel() - flipped.ravel() @ g.ravel()) > 1e-3 * np.linalg.norm(g)  # the check can fail


@settings(max_examples=25, derandomize=True, deadline=None)
@given(st.tuples(st.integers(1, 2), odd(7), odd(7), odd(9), odd(9)))
def test_paper_method_is_the_papers_loop(shape: Shape) -> None:
    H = numbered(shape) + 1
    theirs, ours = paper_loop(H), transpose(H, method="paper")
    assert np.array_equal(ours, theirs)
    written = theirs != 0
    assert np.array_equal(ours[written], closed_form(H)[written])
    assert np.array_equal(transpose(H, method="paper-padded"), closed_form(H))


def test_zero_padding_by_half_a_period_repairs_the_papers_loop() -> None:
    H = numbered((1, 3, 5, 7, 9)) + 1
    padded = np.pad(H, ((0, 0), (0, 0), (0, 0), (1, 1), (2, 2)))
    assert np.array_equal(paper_loop(padded)[..., 1:-1, 2:-2], transpose(H))
    assert not np.array_equal(paper_loop(H), transpose(H))
    wide = numbered((1, 3, 5, 7, 33)) + 1
    assert np.array_equal(transpose(wide, method="paper"), paper_loop(wide))
    assert np.array_equal(transpose(wide, method="paper-padded"), transpose(wide))


def test_paper_method_neither_inverts_nor_keeps_the_sum() -> None:
    H = numbered((1, 5, 5, 7, 7)) + 1
    HT = transpose(H, method="paper")
    assert 0.15 < np.mean(HT == 0) < 0.64
    assert not np.array_equal(transpose(HT, method="paper"), H)
    assert HT.sum() < H.sum()


def test_counter_tests_wrong_conventions_fail() -> None:
    H = numbered((1, 3, 5, 7, 9))
    HT, true = transpose(H), dense_transpose(H)
    assert np.array_equal(HT, true)
    z, y, x, t, s = np.ogrid[:1, :3, :5, :7, :9]
    no_flip = H[z, (y + t - 3) % 3, (x + s - 4) % 5, t, s]
    wrong_sign = H[z, (y - t + 3) % 3, (x - s + 4) % 5, 6 - t, 8 - s]
    wrong_centre = H[z, (y + t - 4) % 3, (x + s - 5) % 5, 6 - t, 8 - s]
    swapped = transpose(H.transpose(0, 2, 1, 4, 3)).transpose(0, 2, 1, 4, 3)
    crossed = transpose(np.ascontiguousarray(H.transpose(0, 2, 1, 3, 4))).transpose(0, 2, 1, 3, 4)
    for wrong in (no_flip, wrong_sign, wrong_centre, crossed, H, H[..., ::-1, ::-1]):
        assert not np.array_equal(wrong, true)
    assert np.array_equal(swapped, true)  # exchanging both pairs of axes together is a symmetry


OTHER_TYPES = ("?", "i1", "u2", ">u2", "i4", "<f2", "f8", ">c8", "c16", "g")


@pytest.mark.parametrize(
    "dtype", ["<f4", ">f4", "c8", *(pytest.param(dtype, marks=pytest.mark.long) for dtype in OTHER_TYPES)]
)
def test_any_number_type(dtype: str) -> None:
    for shape in ((2, 3, 4, 5, 7), (1, 2, 19, 3, 35)):
        H = (numbered(shape) % 251).astype(dtype)
        HT = transpose(H, workers=2)
        assert HT.dtype == H.dtype
        assert np.array_equal(HT, closed_form(H))
        for y, x in ((1, -1), *np.ndindex(shape[1:3])):
            assert np.array_equal(ht_slice(H[0], y, x), HT[0, y, x])
        kind = np.complex128 if H.dtype.kind == "c" else np.float64
        assert depth_sum(H[0]).dtype == kind
        assert np.array_equal(depth_sum(H[0]), H[0].sum(axis=(0, 1), dtype=kind))


def test_payload_of_nan_and_signed_zero_survive() -> None:
    H = np.zeros((1, 2, 17, 3, 19), "f4")
    words = H.view("u4")
    words[:] = np.random.default_rng(0).integers(0, 1 << 32, H.shape, dtype=np.uint32)
    assert np.array_equal(transpose(transpose(H)).view("u4"), words)


def layouts(H: np.ndarray) -> dict[str, np.ndarray]:
    spaced = np.zeros((*H.shape[:4], 2 * H.shape[4]), H.dtype)
    spaced[..., ::2] = H
    raw = np.zeros(H.nbytes + 16, np.uint8)
    misaligned = raw[1 : 1 + H.nbytes].view(H.dtype).reshape(H.shape)
    misaligned[...] = H
    read_only = H.copy()
    read_only.flags.writeable = False
    return {
        "fortran": np.asfortranarray(H),
        "spaced": spaced[..., ::2],
        "turned": np.ascontiguousarray(H[..., ::-1, ::-1])[..., ::-1, ::-1],
        "broadcast": np.broadcast_to(H[:1], H.shape),
        "misaligned": misaligned,
        "read-only": read_only,
        "swapped axes": np.ascontiguousarray(H.transpose(0, 2, 1, 3, 4)).transpose(0, 2, 1, 3, 4),
    }


@pytest.mark.parametrize("dtype", ["f4", "c8", ">f8"])
def test_any_memory_layout(dtype: str) -> None:
    for name, H in layouts(numbered((2, 3, 5, 7, 19), dtype)).items():
        expected = closed_form(H)
        assert np.array_equal(transpose(H), expected), name
        zeros = np.zeros_like(expected)
        out = layouts(zeros)[name] if name not in ("broadcast", "read-only") else zeros
        assert transpose(H, out=out) is out
        assert np.array_equal(out, expected), name
        assert np.array_equal(ht_slice(H[1], 2, 3), expected[1, 2, 3])
        assert np.allclose(depth_sum(H[1]), np.asarray(H[1]).sum(axis=(0, 1)), rtol=1e-14)
    H = numbered((1, 3, 4, 5, 7), "f4")
    out = np.zeros((5, 14), "f4")[:, ::2]
    assert ht_slice(H[0], 2, 1, out=out) is out and np.array_equal(out, closed_form(H)[0, 2, 1])


def test_memory_maps_datasets_and_matrices(tmp_path: Path) -> None:
    H = numbered((2, 3, 5, 7, 19), "f4")
    expected = closed_form(H)
    np.save(tmp_path / "H.npy", H)
    mapped = np.load(tmp_path / "H.npy", mmap_mode="r")
    out = np.lib.format.open_memmap(tmp_path / "HT.npy", "w+", H.dtype, H.shape)
    transpose(mapped, out=out)
    out.flush()
    assert np.array_equal(np.load(tmp_path / "HT.npy"), expected)
    assert type(transpose(mapped)) is np.ndarray
    assert np.array_equal(ht_slice(mapped[0], 2, 4), expected[0, 2, 4])
    with h5py.File(tmp_path / "H.h5", "w") as file:
        assert np.array_equal(transpose(file.create_dataset("H", data=H)), expected)
    assert np.array_equal(transpose(PSFMatrix(H)), expected)
    assert np.array_equal(transpose(H.tolist()), closed_form(H.astype("f8")))


def test_the_number_of_threads_changes_nothing() -> None:
    H = np.random.default_rng(1).random((2, 7, 9, 27, 31), np.float32)
    for workers in (1, 2, 5):
        assert np.array_equal(transpose(H, workers=workers), closed_form(H))
        assert np.array_equal(depth_sum(H[0], workers=workers), depth_sum(H[0], workers=1))


def test_out_that_overlaps_is_refused(tmp_path: Path) -> None:
    memory = np.zeros(2 * 3 * 4 * 5 * 7 * 2, "f4")
    H = memory[: memory.size // 2].reshape(2, 3, 4, 5, 7)
    late = memory[7 : 7 + H.size].reshape(H.shape)
    beside = memory[memory.size // 2 :].reshape(H.shape)
    for out in (H, late):
        with pytest.raises(InputError, match="memory shared with H"):
            transpose(H, out=out)
    assert transpose(H, out=beside) is beside
    with pytest.raises(InputError, match="memory shared with H"):
        transpose(PSFMatrix(H), out=H)
    first = np.lib.format.open_memmap(tmp_path / "H.npy", "w+", "f4", H.shape)
    with pytest.raises(InputError, match="memory shared with H"):
        transpose(first, out=np.load(tmp_path / "H.npy", mmap_mode="r+"))


def test_arguments_that_do_not_fit_are_refused() -> None:
    H = numbered((1, 3, 4, 5, 7), "f4")
    read_only = np.zeros_like(H)
    read_only.flags.writeable = False
    for out, found in (
        (np.zeros((1, 3, 4, 5, 9), "f4"), "(1, 3, 4, 5, 9)"),
        (np.zeros(H.shape), "float64"),
        (H.tolist(), "list"),
        (read_only, "read-only"),
    ):
        with pytest.raises(InputError, match="out: expected") as error:
            transpose(H, out=out)  # type: ignore[arg-type]
        assert found in str(error.value)
    with pytest.raises(InputError, match="expected exact, paper or paper-padded, got 'fast'"):
        transpose(H, method="fast")
    for method in ("paper", "paper-padded"):
        with pytest.raises(InputError, match="odd period in y and x, got 3 x 4; use the method exact"):
            transpose(H, method=method)
    for wrong in (H[0], H[..., :6], H[..., :4, :], H[:0]):
        with pytest.raises(InputError):
            transpose(wrong)
    for dtype in ("S3", "O", "M8[s]", "G"):
        with pytest.raises(InputError, match="dtype"):
            transpose(np.zeros((1, 1, 1, 3, 3), dtype))
    with pytest.raises(IndexError, match="outside the period"):
        ht_slice(H[0], 3, 0)
    with pytest.raises(InputError, match="out"):
        ht_slice(H[0], 0, 0, out=np.zeros((5, 7)))
    with pytest.raises(InputError):
        ht_slice(H, 0, 0)


def test_depth_sum_is_accurate_in_double_precision() -> None:
    rng = np.random.default_rng(4)
    plane = (rng.standard_normal((37, 29, 3, 5)) * 10.0 ** rng.integers(-6, 6, (37, 29, 3, 5))).astype("f4")
    exact = plane.astype(np.longdouble).sum(axis=(0, 1))
    size = np.abs(plane.astype(np.longdouble)).sum(axis=(0, 1))
    assert np.all(np.abs(depth_sum(plane) - exact) <= 37 * 29 * 2.0**-53 * size)
    single = plane.sum(axis=(0, 1), dtype=np.float32)
    assert np.any(np.abs(single - exact) > 37 * 29 * 2.0**-53 * size)  # single precision would not do
    huge = np.full((9, 9, 1, 3), np.iinfo(np.uint32).max, np.uint32)
    assert np.all(depth_sum(huge) == 81 * (2.0**32 - 1))


@settings(max_examples=20, derandomize=True, deadline=None)
@given(st.tuples(st.integers(1, 2), odd(5), odd(5), odd(9), odd(9)))
def test_border_energy_bounds_what_the_paper_drops(shape: Shape) -> None:
    assume(min(shape[1:3]) > 1)
    H = numbered(shape, "f8") + 1
    dropped = 1 - transpose(H, method="paper").sum() / H.sum()
    assert -1e-12 <= dropped <= border_energy(H) + 1e-12


@pytest.mark.parametrize(
    "dtype", ["u2", *(pytest.param(dtype, marks=pytest.mark.long) for dtype in ("f4", "i4", "?", "c8"))]
)
def test_border_energy_of_known_patterns(dtype: str) -> None:
    H = np.zeros((2, 5, 4, 11, 15), dtype)
    H[:, :, :, 2:9, 2:13] = 1
    assert border_energy(H) == 0
    assert border_warning(H) is None
    H[:, :, :, 1, 7] = 1
    assert border_energy(H) == pytest.approx(1 / 78)
    assert "1.28 % of the energy is within 2 rows or 2 columns" in str(border_warning(H))
    assert border_warning(H, limit=0.02) is None
    assert border_energy(PSFMatrix(H)) == border_energy(H)


def test_negative_values_have_energy_and_small_cutouts_are_all_border() -> None:
    H = np.ones((1, 1, 3, 3, 5))
    H[..., 0] = -1
    assert border_energy(H) == pytest.approx(2 / 5)
    assert border_energy(np.ones((1, 5, 5, 3, 3))) == 1
    assert border_energy(np.zeros((1, 5, 5, 3, 3))) == 0


# -- kernels -----------------------------------------------------------------------------------------------------------


GUARD = 97


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


OTHER_SIZES = [pytest.param(size, marks=pytest.mark.long) for size in (np.uint8, np.uint16, np.uint64)]


@pytest.mark.parametrize("dtype", [np.uint32, *OTHER_SIZES])
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
