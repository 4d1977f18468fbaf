"""Options of ``lfcal multiplex`` against the library."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.multiplex import cfa, demultiplex
from tests.cli.conftest import Run


@pytest.mark.parametrize("route", ["spatial", "fourier"])
def test_demosaic_by_a_route(lfcal: Callable[..., Run], tmp_path: Path, route: str) -> None:
    frame = np.random.default_rng(1).integers(0, 4000, (16, 18)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    command = ("multiplex", "demosaic", tmp_path / "frame.png", "--out", tmp_path / "rgb.tif", "--pattern", "GRBG")
    done = lfcal(*command, "--route", route)
    assert done.code == 0, done.err
    ways = {way: demultiplex(frame.astype(np.float32), cfa("GRBG"), route=way) for way in ("spatial", "fourier")}
    made = tifffile.imread(tmp_path / "rgb.tif")
    np.testing.assert_allclose(made, ways.pop(route), rtol=1e-4, atol=1e-2)
    assert np.abs(made - ways.popitem()[1]).max() > 10, "the routes differ"
    refused = lfcal(*command, "--force", "--route", "scenic")
    assert refused.code == 2 and "spatial" in refused.err
