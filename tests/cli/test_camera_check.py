"""``lfcal camera check``: what does not fit the white image is written on demand alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from tests.cli.conftest import Run
from tests.lattice.white_frames import draw_white

SHAPE = (230, 270)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a white image and a camera of a fifth longer pitch."""
    root = tmp_path_factory.mktemp("check")
    truth = draw_white(SHAPE, pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.004)
    tifffile.imwrite(root / "white.tif", truth.frame)
    tifffile.imwrite(root / "dark.tif", np.full(SHAPE, 100, np.uint16))
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 100.0, 400.0, types, 0.004, (-1.0, 1.5))
    (root / "camera.json").write_text(Camera("c", MainLens(), lattice, Sensor(SHAPE, 5.0)).to_json())
    return root


def words(folder: Path, *options: object) -> tuple[object, ...]:
    names = (folder / "camera.json", folder / "white.tif", "--dark", folder / "dark.tif", "--workers", "2")
    return ("camera", "check", *names, *options)


def test_a_camera_that_does_not_fit_is_written_on_demand_alone(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "measured.json"
    done = lfcal(*words(folder, "-o", out))
    assert done.code == 1 and "does not fit" in done.out and not out.exists()
    assert "nothing written: camera and white image do not fit" in done.err and "--anyway" in done.err
    done = lfcal(*words(folder, "-o", out, "--json"))
    assert done.code == 1 and done.json["written"] is None and not out.exists()  # type: ignore[index]
    done = lfcal(*words(folder, "-o", out, "--anyway"))
    assert done.code == 0 and "do not fit" not in done.err
    measured = Camera.from_json(out.read_text())
    assert measured.pitch_px == pytest.approx(16.0, abs=0.01) and measured.marks["lattice.pitch_um"] == "measured"


def test_what_has_no_measured_lattice_is_refused_even_so(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    camera = Camera.from_json((folder / "camera.json").read_text())
    other = tmp_path / "other.json"
    other.write_text(replace(camera, sensor=Sensor((100, 100), 5.0)).to_json())
    done = lfcal("camera", "check", other, folder / "white.tif", "-o", tmp_path / "m.json", "--anyway")
    assert done.code == 2 and "sensor of the white image" in done.err and not (tmp_path / "m.json").exists()
