"""Commands as documented, of a camera whose noise is not stated: ``fit`` needs no --noise."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lfcal.camera import Camera
from lfcal.frames.described import sensor_noise
from tests.fit.commands import typed

FIT = ("--unknowns", "geometry", "--positions", 10, "--no-h", "--workers", 1)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record the whole period of a small camera with the simulator, and assemble it."""
    folder = tmp_path_factory.mktemp("noise")
    optics = ("--sensor", "96x96,5.5", "--lens", "50,4,300", "--array", "square", "--pitch", "11px", "--gap", 290)
    black = ("--set", "sensor.black_level=64")
    typed(folder, "camera", "new", "--type", "focused", *optics, "--focus", 3, *black, "--yes", "-o", "camera.json")
    typed(folder, "plan", "camera.json", "--virtual-depths", 4, "-o", "plan.json")
    typed(folder, "acquire", "plan.json", "--backend", "sim", "--out", "session")
    typed(folder, "assemble", "session", "-o", "H.h5")
    return folder


@pytest.mark.long
@pytest.mark.parametrize("source", ["H.h5", "session"])
def test_fit_measures_the_noise_that_nobody_states(place: Path, source: str) -> None:
    """Its figures are those of the simulated sensor, so that chi² is about 1."""
    _, said = typed(place, "fit", source, "-o", f"fit-{source}", *FIT, drawn=False)
    assert "noise of the frames: floor from neighbouring positions" in said
    numbers = json.loads((place / f"fit-{source}" / "fit.json").read_text())
    assert numbers["chi2"]["lit"] == pytest.approx(1.0, abs=0.1)
    wanted = sensor_noise(Camera.from_json((place / "camera.json").read_text()).sensor)
    noise = numbers["noise"]
    # the mean of eight darks is subtracted
    assert noise["floor"] == pytest.approx(1.125 * float(wanted.constant), rel=0.1)
    assert noise["slope"] == pytest.approx(float(wanted.slope), rel=0.1)
