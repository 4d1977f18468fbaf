from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import StageAxes


def test_axes_are_mapped_with_their_signs() -> None:
    stage = StageAxes(right="-y", down="+z", away="-x", origin_um=(1.0, 2.0, 3.0))
    moved = stage.to_stage(np.array([[10.0, 20.0, 30.0], [0.0, 0.0, 0.0]]))
    assert moved.tolist() == [[1.0 - 30.0, 2.0 - 10.0, 3.0 + 20.0], [1.0, 2.0, 3.0]]
    assert stage.to_object(moved) == pytest.approx(np.array([[10.0, 20.0, 30.0], [0.0, 0.0, 0.0]]))


@pytest.mark.parametrize(
    "values",
    [
        {"right": "x"},
        {"right": "+w"},
        {"right": 1},
        {"right": "+y"},
        {"away": "-x"},
        {"origin_um": (0.0, 0.0)},
        {"origin_um": (0.0, 0.0, math.nan)},
        {"origin_um": "abc"},
    ],
)
def test_bad_axes_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(InputError, match="expected"):
        StageAxes(**values)  # type: ignore[arg-type]
