"""Positions and their order in storage."""

from __future__ import annotations

import numpy as np

from lfcal.base.axes import Position, position_at


def test_positions_count_in_storage_order() -> None:
    shape = (3, 4, 5)
    found = [position_at(flat, shape[1:]) for flat in range(np.prod(shape))]
    assert found == [Position(*place) for place in np.ndindex(*shape)]
