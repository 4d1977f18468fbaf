from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.cli import main
from tests.lattice.white_frames import WhiteFrame, draw_white

Run = Callable[..., tuple[int, str, str]]
EDGES = (3.9, 2.6, 1.6)


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``lfcal`` in this process; return exit code, output and errors."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lfcal", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
            raise SystemExit(0)
        out, err = capsys.readouterr()
        return int(stop.value.code or 0), out, err

    return call


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, WhiteFrame]:
    """Write white, dark and camera files of a three-type camera."""
    folder = tmp_path_factory.mktemp("white")
    truth = draw_white((330, 400), pitch=16.0, edges=EDGES, fill=0.85, step=2)
    tifffile.imwrite(folder / "white.tif", truth.frame)
    tifffile.imwrite(folder / "dark.tif", np.full(truth.frame.shape, 100, np.uint16))
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    camera = Camera("c", MainLens(), LensletLattice("hexagonal", 82.0, 400.0, types), Sensor(truth.frame.shape, 5.0))
    (folder / "camera.json").write_text(camera.to_json())
    return folder, truth


def test_the_fit_is_shown_and_becomes_the_camera_s(run: Run, files: tuple[Path, WhiteFrame], tmp_path: Path) -> None:
    folder, _ = files
    code, out, err = run(
        "white",
        folder / "white.tif",
        "--dark",
        folder / "dark.tif",
        "--camera",
        folder / "camera.json",
        "-o",
        tmp_path / "out",
    )
    assert (code, err) == (0, "")
    for shown in ("hexagonal", "±", "px", "affine", "lens types", "standard errors"):
        assert shown in out
    measured = Camera.from_json((tmp_path / "out/camera.json").read_text())
    assert measured.pitch_px == pytest.approx(16.0, abs=0.005)
    assert measured.lattice.type_step == 2
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"camera.json", "lattice.json", "residuals.csv", "residuals.png"}


def test_json(run: Run, files: tuple[Path, WhiteFrame], tmp_path: Path) -> None:
    folder, _ = files
    code, out, _ = run("white", folder / "white.tif", "-o", tmp_path, "--json")
    assert code == 0
    data: dict[str, Any] = json.loads(out)
    assert data["pitch_px"] == pytest.approx(16.0, abs=0.005) and data["lens_types"] is None
    assert len(data["dead"]) == pytest.approx(0.05 * data["lenslets"], rel=0.5)
    assert {path.name for path in tmp_path.iterdir()} == {Path(path).name for path in data["written"]}


def test_types_are_left_alone_where_nobody_asks(run: Run, files: tuple[Path, WhiteFrame]) -> None:
    folder, _ = files
    white, camera = folder / "white.tif", folder / "camera.json"
    asked, not_asked = (
        json.loads(run("white", white, "--camera", camera, option, "--json")[1]) for option in ("--types", "--no-types")
    )
    assert asked["lens_types"]["type_step"] == 2 and asked["camera"]["lattice"]["type_step"] == 2
    assert not_asked["lens_types"] is None and not_asked["camera"]["lattice"]["type_step"] == 1
    assert asked["pitch_px"] == not_asked["pitch_px"]


@pytest.mark.long
def test_a_nominal_pitch_and_kind_lead_to_the_same_lattice(run: Run, files: tuple[Path, WhiteFrame]) -> None:
    folder, _ = files
    found, led = (
        json.loads(run("white", folder / "white.tif", *more, "--json")[1])
        for more in ((), ("--pitch", "15", "--kind", "hexagonal"))
    )
    assert led["kind"] == found["kind"] == "hexagonal"
    assert led["pitch_px"] == pytest.approx(found["pitch_px"], abs=1e-3)


def test_bad_input_is_one_line_and_leaves_nothing(run: Run, files: tuple[Path, WhiteFrame], tmp_path: Path) -> None:
    folder, _ = files
    white, camera = folder / "white.tif", folder / "camera.json"
    out = tmp_path / "out"
    for arguments in (
        (folder / "absent.tif",),
        (folder / "dark.tif",),
        (camera,),
        (white, "--kind", "round"),
        (white, "--pitch", "20"),
        (white, "--camera", "r29", "-o", out, "--no-types"),
        (white, "--camera", "lfm_20x05", "-o", out),
    ):
        code, shown, err = run("white", *arguments)
        assert code == 2 and shown == ""
        assert len(err.strip().splitlines()) == 1 and err.startswith("lfcal: ")
        assert not out.exists()


@pytest.mark.long
def test_colours(run: Run, files: tuple[Path, WhiteFrame], tmp_path: Path) -> None:
    """One colour of RGB, a mosaic named or not: the lattice is that of the grey image, and the remedy is an option."""
    _, truth = files
    frame = truth.frame.astype(float) - 100
    tifffile.imwrite(tmp_path / "rgb.tif", np.stack([truth.frame // 4, truth.frame, truth.frame // 2], -1))
    mosaic = frame.copy()
    mosaic[0::2, 0::2] *= 0.5
    mosaic[1::2, 1::2] *= 0.35
    np.save(tmp_path / "mosaic.npy", mosaic)
    code, _, err = run("white", tmp_path / "rgb.tif")
    assert code == 2 and "--channel G" in err and "each" not in err and "colour=" not in err
    for given in (("rgb.tif", "--channel", "G"), ("mosaic.npy",), ("mosaic.npy", "--cfa", "RGGB")):
        code, out, err = run("white", tmp_path / given[0], *given[1:], "--json")
        assert (code, err) == (0, "")
        assert json.loads(out)["pitch_px"] == pytest.approx(16.0, abs=0.003)
    for wrong in (("rgb.tif", "--channel", "each"), ("mosaic.npy", "--channel", "G"), ("mosaic.npy", "--cfa", "RGX")):
        code, shown, err = run("white", tmp_path / wrong[0], *wrong[1:])
        assert code == 2 and shown == "" and len(err.strip().splitlines()) == 1


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("pitch", [12.0, 13.4])
def test_each_colour_of_a_mosaic_has_the_lattice_of_the_sensor(
    run: Run, tmp_path: Path, pattern: str, pitch: float
) -> None:
    """A plane of one colour is on the pixels of the sensor: no half pixel goes lost, whichever filter comes first."""
    soft: dict[str, Any] = {"edges": (2.5,), "fill": 0.6, "snr": 1e4, "dead": 0.0, "falloff": 0.0}
    truth = draw_white((150, 170), pitch, rotation=0.0, offset=(0.2, 0.35), **soft)
    gains = np.array([{"R": 0.5, "G": 1.0, "B": 0.35}[colour] for colour in pattern]).reshape(2, 2)
    np.save(tmp_path / "white.npy", (truth.frame - 100.0) * np.tile(gains, (75, 85)))
    for channel in ("R", "G", "B", ""):
        given = ("--channel", channel) if channel else ()
        code, out, err = run("white", tmp_path / "white.npy", "--cfa", pattern, *given, "--json")
        assert code == 0, err
        found = json.loads(out)
        assert truth.distance_to_lattice(tuple(found["origin_px"])) < 0.02, channel
        assert found["pitch_px"] == pytest.approx(pitch, abs=0.002)
