"""Kernels that are not compiled for little work: the other way gives the same result, and the choice is stable."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfcal.base import FileFormatError, compiled, kernel_spared, kernels_spared, sparing_kernels
from lfcal.frames.corrections._kernels import CorrectionTerms, correct
from lfcal.frames.formats.png import PngImage
from lfcal.judge.quality._dark import dark_corners
from lfcal.judge.quality._lattice import spot_waves
from lfcal.judge.quality.measure import _steps
from lfcal.judge.quality.pattern_table import PatternTable
from lfcal.lattice._kernels import Support
from lfcal.lattice._micro_image import light_of, mean_micro_image, place_lenslets
from lfcal.psf._transpose import depth_sum, ht_slice, transpose
from lfcal.psf.aperture._arcs import Arcs
from lfcal.psf.store import _rounded, _rounded_sums
from lfcal.reconstruct.projectors._kernels import Tiling
from lfcal.reconstruct.projectors._windows import add_windows, copy_windows, place_patterns
from lfcal.reconstruct.solvers._em import _update_factors
from lfcal.reconstruct.solvers.records import _sums
from lfcal.simulate import simulate_psf
from lfcal.simulate.engines._kernels import LensAperture, Split, fill_disc
from lfcal.simulate.engines._polygon import regular, spectrum
from tests.frames.scenes import png_bytes
from tests.simulate.common import small_plan

KERNEL = (
    "from lfcal.base.compiled import njit\n\n"
    "@njit()\ndef inner(a):\n    return a + 1\n\n"
    "@njit()\ndef outer(a):\n    return 2 * inner(a)\n"
)
RNG = np.random.default_rng(1)
PLANE = RNG.normal(size=(5, 6, 21, 23)).astype(np.float32)
IMAGE = RNG.integers(0, 60000, (40, 50)).astype(np.uint16)
CENTRES = np.stack(np.meshgrid(np.arange(8, 40, 7.3), np.arange(8, 32, 7.1)), -1).reshape(-1, 2)
WHITE = (1000 * np.cos(np.indices((40, 50)) / 1.2).sum(0) + 2000).astype(np.float32)
WAVES = np.array([[0.3, -0.8], [1.1, 0.2]])


def corrected() -> Any:
    maps = IMAGE.astype(np.float32) / 7, 1 + IMAGE.astype(np.float32) / 1e6
    out = np.empty(IMAGE.shape, np.float32)
    correct(IMAGE, CorrectionTerms(*maps, np.float32(3), np.float32(1.1), 2.0, 0.1, 0.01), out, 1)
    return out


def disc() -> Any:
    table, mask = np.linspace(1, 0, 300, dtype=np.float32), np.zeros((2, 31, 31), np.float32)
    aperture = LensAperture(table, table**2, 2.0, np.zeros((0, 0), np.float32), 1.0, 0.0, 0.0)
    fill_disc(aperture, 0.7, 0.1, -0.2, Split(*mask))
    return mask


def placed() -> Any:
    micro = mean_micro_image(WHITE, CENTRES, np.ones(len(CENTRES)), 3.2, 1)
    found = place_lenslets(WHITE, CENTRES, micro, Support(1 / 9, 0.0, 1 / 9), 1)
    return np.concatenate([micro.table.ravel(), found.shifts.ravel(), found.gains])


def frequencies() -> Any:
    f = np.fft.fftfreq(24, 0.3)
    return spectrum(regular(7, 0.2), f, f)


def added() -> Any:
    image = np.ones((50, 60), np.float32)
    add_windows(PLANE[1], image, Tiling(2, 3, 7, 9), 4)
    return image


def copied() -> Any:
    windows = np.zeros((5, 21, 23), np.float32)
    copy_windows(windows, WHITE, Tiling(1, 4, 8, 6), 3)
    return windows


def placed_patterns() -> Any:
    band = np.full((5, 6, 18, 40), 7, np.float32)
    place_patterns(PLANE, np.array([-30, -4, 3, 0, 18]), np.arange(6) * 3, band)
    return band


def measured() -> Any:
    plane = PLANE.copy()
    plane[1, 2, 3:5, 4] = np.nan
    found = PatternTable.of(plane, dark_corners(PLANE), 1)
    checksums = (found.digest >> np.uint64(32)) / 2.0**32
    return np.concatenate([part.ravel() for part in (found.table, found.lit, found.sensor, checksums)])


def outlines() -> Any:
    angles = np.linspace(-3, 3, 50)
    arcs = Arcs(9.0, 0.4, 6, 0.3, 2, 0.1, (0.5, 0.8, 0.3), 0.02, -0.03)
    return np.stack([one.radius(angles, 1.0, -2.0) for one in (arcs, Arcs(7.0), Arcs(3.0, 0.0, 5))])


def factors() -> Any:
    above, share, seen = PLANE[:3, 0]
    out = np.empty_like(above)
    _update_factors(above, share, seen, 0.2, out)
    return out


def simulated(workers: int = 1) -> Any:
    return simulate_psf(small_plan(cutout=31), "auto", "grid", tolerance=0.03, workers=workers).plane(0)


WORK: dict[str, tuple[Callable[..., Any], float]] = {
    "transpose_batches": (lambda: transpose(PLANE[None]), 0),
    "gather_slice": (lambda: ht_slice(PLANE, 2, 3), 0),
    "add_patterns": (lambda: depth_sum(PLANE), 1e-13),
    "correct_rows": (corrected, 0),
    "round_pattern": (lambda: _rounded(PLANE[1, 2], 2**-6), 0),
    "add_rounded": (lambda: _rounded_sums(PLANE, 2**-6, 1)[0], 0),
    "lenslet_statistics": (lambda: light_of(WHITE, CENTRES, 3.0, 1), 1e-6),
    "fold": (placed, 1e-5),
    "register": (placed, 1e-5),
    "_edge_rows": (frequencies, 1e-13),
    "mask_from_disc": (disc, 1e-6),
    "respond": (simulated, 2e-6),
    "frame_pass": (measured, 1e-12),
    "arcs_radius": (outlines, 1e-13),
    "overlap_add": (added, 0),
    "gather_windows": (copied, 0),
    "lay_patterns": (placed_patterns, 0),
    "update_factors": (factors, 0),
    "squares_of": (lambda: np.array(_sums(PLANE[0], PLANE[1])), 1e-13),
    "spot_pass": (lambda: spot_waves(PLANE[0], 0.5, WAVES), 1e-6),
    "step_pass": (lambda: _steps(PLANE, dark_corners(PLANE), 1), 1e-6),
}
"""Work by the kernel that is spared, and the largest difference relative to the largest value."""


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[str, str], float]:
    """Return the work done without kernels; there is no limit, and no kernel counts as compiled."""
    spared: dict[tuple[str, str], float] = {}
    monkeypatch.setattr(compiled, "_SPARED", spared)
    monkeypatch.setattr(compiled, "_KEPT", defaultdict(bool))
    monkeypatch.setattr(compiled, "_is_kept", lambda *_: False)
    monkeypatch.setattr(compiled, "SPARED_S", 1e9)
    return spared


@pytest.mark.parametrize("kernel", WORK)
def test_work_without_a_kernel_gives_the_same(kernel: str, request: pytest.FixtureRequest) -> None:
    work, largest = WORK[kernel]
    expected = work()
    spared = request.getfixturevalue("uncompiled")
    found = work()
    assert kernel in {name for _, name in spared}
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=0, atol=largest * np.abs(expected).max())
    again = simulated(3) if work is simulated else work()
    np.testing.assert_array_equal(again, found, err_msg="the same again, by any number of threads")


def test_a_frame_is_read_without_a_kernel(tmp_path: Path, uncompiled: dict[tuple[str, str], float]) -> None:
    path = tmp_path / "frame.png"
    cv2.imwrite(str(path), IMAGE)
    found = PngImage(path).read()
    np.testing.assert_array_equal(found, IMAGE)
    assert found.dtype == IMAGE.dtype and [name for _, name in uncompiled] == ["unfilter"]


def test_an_unknown_filter_is_found_without_a_kernel(tmp_path: Path, uncompiled: dict[tuple[str, str], float]) -> None:
    path = tmp_path / "frame.png"
    path.write_bytes(png_bytes(2, 2, 8, 0, bytes([0, 1, 2, 9, 3, 4])))
    with pytest.raises(FileFormatError, match="damaged data"):
        PngImage(path).read()
    assert uncompiled


def test_a_kernel_is_spared_until_its_work_is_worth_compiling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "spared_kernels.py").write_text(KERNEL, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(compiled, "SPARED_S", 0.5)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    import spared_kernels as m  # type: ignore[import-not-found]

    assert not m.outer.spared(0.1), "outside a command, kernels are compiled"
    with sparing_kernels():
        assert not kernels_spared()
        assert [m.outer.spared(0.2) for _ in range(4)] == [True, True, False, False]
        assert m.inner.spared(0.2), "each kernel has its own limit"
        assert [kernel_spared("spared_kernels", "slow", 0.4, slow=2.0) for _ in range(3)] == [True, True, False]
        assert kernels_spared()
    with sparing_kernels():
        assert m.outer.for_work(0.2)(3) == 8
        assert m.outer._compiled is None and m.inner._compiled is None
        assert m.outer(3) == 8 and not m.outer.spared(0.1), "it is compiled now"
    # a later process finds it on disk
    monkeypatch.setattr(compiled, "_KEPT", {})
    with sparing_kernels():
        assert not kernel_spared("spared_kernels", "outer", 0.1)
        assert kernel_spared("spared_kernels", "outers", 0.1)
    del sys.modules["spared_kernels"]
