"""The projection of a Fourier light-field microscope compared with its bare FFTs."""

from __future__ import annotations

import pytest

from benchmarks.fourier import measure
from tests.benchmarks.test_commands import Bench, bench

__all__ = ["bench"]


def test_both_are_timed_and_the_projection_is_right(bench: Bench) -> None:
    found = bench.json("fourier", "--image", 64, "--cutout", 31, "--planes", 2, "--repeats", 1)
    assert found["transforms"] == 6 and found["method"] == "fft"
    assert found["error"] < 1e-5 and found["ratio"] > 0 and found["step_ratio"] > 0
    assert "FFTs alone" in bench("fourier", "--image", 64, "--cutout", 31, "--planes", 2, "--repeats", 1)


@pytest.mark.long
def test_an_iteration_takes_at_most_a_fifth_more_than_its_ffts() -> None:
    found = measure(1200, 859, 9, 9)
    assert found.ratio < 1.2 and found.step_ratio < 1.2
