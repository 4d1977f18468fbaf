"""The rivals of ``python -m benchmarks transpose`` do what they claim, and its table names what was scaled."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest

from benchmarks import _transposers as ways
from benchmarks import transpose as program
from lfcal.base.errors import InputError, LfcalError
from lfcal.psf import transpose
from tests.benchmarks.conftest import Bench


def test_the_loop_of_the_paper_is_timed() -> None:
    H = ways.random_matrix((2, 3, 5, 7, 9))
    out = np.zeros_like(H)
    found = ways.paper_loop(H, out, 60)
    assert found.share == 1
    assert np.array_equal(out, transpose(H, method="paper"))
    assert ways.paper_loop(ways.random_matrix((1, 5, 5, 41, 41)), np.zeros((1, 5, 5, 41, 41)), 0.0).share < 0.01


def test_copies_and_reads_cover_every_value() -> None:
    H = ways.random_matrix((1, 3, 3, 5, 7))
    out = np.zeros_like(H)
    ways.copy_parallel(H, out, 3)
    assert np.array_equal(out, H)
    ways.read_once(H, 2)
    words = np.arange(1, 1001, dtype=np.uint64)
    assert ways._read_words(words, 0, 1000) == int(np.bitwise_xor.reduce(words))
    with pytest.raises(LfcalError, match="transposed matrix"):
        ways.check_transposed(H, H)


def test_the_least_time_of_interleaved_work() -> None:
    calls: list[str] = []
    ticks = iter([0, 3, 10, 15, 20, 21, 30, 37])  # 3 and 1 for a, 5 and 7 for b
    times = ways.interleaved({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 2, lambda: next(ticks))
    assert calls == ["a", "b"] * 3
    assert times == {"a": 1, "b": 5}


def test_a_stand_in_with_pyolafs_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {}

    def backward(H: np.ndarray, resolution: dict[str, np.ndarray], crange: str, order: list[int]) -> np.ndarray:
        seen.update(resolution, crange=crange)
        return H[: resolution["Nnum"][0], : resolution["Nnum"][1]]

    module = ModuleType("pyolaf")
    module.lf = ModuleType("pyolaf.lf")  # type: ignore[attr-defined]
    module.lf.LFM_computeBackwardPatterns = backward  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pyolaf", module)
    monkeypatch.setitem(sys.modules, "pyolaf.lf", module.lf)
    H = ways.random_matrix((1, 3, 3, 9, 9))
    values, found = ways.pyolaf_backward(H, 2, 11)
    assert np.allclose(values, H[0, :2, :2])
    assert found.share == pytest.approx(4 / 99)
    assert seen["TexNnum_half"].tolist() == [2, 2]
    assert seen["usedLensletCenters"]["px"].min() == -9


def test_small_sizes_from_end_to_end(bench: Bench) -> None:
    out = bench(*"transpose --sizes 17/3,19/4x5,99/31 --quick --planes 3 --memory 0.00015".split())
    assert "* scaled, because not all planes fit into the memory: 19/4x5 (2 of 3 planes)." in out
    assert "Not run, because two copies of a plane do not fit into the memory: 99/31." in out
    assert "pyolaf: not run" in out and "HT slice and depth sum: not run" in out
    small = "transpose --sizes 17/3 --quick --memory 0.01 --workers 1".split()
    (row,) = bench.json(*small)["rows"]
    assert row["planes_run"] == row["planes"] == 11
    assert row["ratio"] == pytest.approx(row["lfcal"] / min(row["copy"], row["copy_parallel"]))
    assert row["processor_ratio"] is None or row["processor_ratio"] > 0
    markdown = bench(*small, "--markdown")
    assert markdown.startswith("| ns | ny x nx | H | lfcal |") and "| 17 | 3 x 3 | 114.4 kB |" in markdown
    assert "shortest times (s), 1 threads" in bench(*small)


def test_plane_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "TABLE_1", (*program.TABLE_1[:-1], program.Size(21, 5, 7)))
    settings = program.Settings(1, 10**6, 1, 1, 0.1, 1)
    plane = program.measure_plane(settings)
    assert plane is not None
    assert plane.nbytes == 4 * 5 * 7 * 21**2
    lines = program.notes([], plane, program.Pyolaf("0.2.1", found=ways.Scaled(60.0, 0.5), same_as_paper=True))
    assert any("median" in line and "(bound 2 ms)" in line for line in lines)
    assert lines[-1].endswith("60 s, scaled from 50.00% of the work; the values equal those of method paper.")


def test_sizes_are_those_of_table_1_or_chosen() -> None:
    names = "111/11 221/11 331/11 551/11 771/11 1101/11 127/21 187/31 307/51 181/55x95"
    assert [size.name for size in program.TABLE_1] == names.split()
    assert program.chosen("111/11, 9/3x5")[0].printed == (29.0, 1.3, 14.5, 0.2)
    assert program.chosen("9/3x5") == (program.Size(9, 3, 5),)
    for text in ("111", "110/11", "111/0", "a/b", "1/2/3", "-3/1"):
        with pytest.raises(InputError, match="odd pixels/positions"):
            program.chosen(text)
