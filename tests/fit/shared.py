"""Patterns of the camera's model that tests share: the same places of the same camera come again in each of them."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.fit.model import PlaneModel

Key = tuple[bytes, bytes, bytes]
MOST_BYTES = 300_000_000

KEPT: dict[Key, NDArray[np.float32]] = {}


@contextmanager
def shared_models() -> Iterator[None]:
    """Keep what `PlaneModel` computes by all that it depends on: setup, scan, plane, fineness, places and sources."""
    made, computed = PlaneModel.__init__, PlaneModel.patterns
    named: dict[int, bytes] = {}

    def make(self: PlaneModel, *arguments: object) -> None:
        made(self, *arguments)  # type: ignore[arg-type]
        named[id(self)] = pickle.dumps(arguments)

    def patterns(self: PlaneModel, places: NDArray[np.intp], offsets_px: NDArray[np.float64]) -> NDArray[np.float32]:
        key = (named[id(self)], np.asarray(places, np.intp).tobytes(), np.asarray(offsets_px, np.float64).tobytes())
        if key not in KEPT:
            found = computed(self, places, offsets_px)
            # a list, at once: other threads put theirs in meanwhile
            if sum(one.nbytes for one in list(KEPT.values())) + found.nbytes > MOST_BYTES:
                return found
            KEPT[key] = found
        return KEPT[key].copy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PlaneModel, "__init__", make)
        patch.setattr(PlaneModel, "patterns", patterns)
        yield
