"""The part that the documentation adds."""

from __future__ import annotations

import numpy as np

from lfcal.accuracy import Subject, measure_curve
from lfcal.psf import PSFMatrix
from tests.distribution import names_of


def test_the_part_of_the_documentation_measures() -> None:
    names = names_of("extending.md", "An accuracy curve")
    H = PSFMatrix(np.random.default_rng(0).random((1, 6, 6, 3, 3)).astype(np.float32))
    curve = measure_curve(names["MEAN_LIGHT"], Subject.of_matrix(H, "H"), 10)
    assert curve.stopped == "" and len(curve.points) == 5
    # the mean of n patterns scatters by 1/sqrt(n)
    assert 0.15 < curve.points[-1].error / curve.points[0].error < 0.4
