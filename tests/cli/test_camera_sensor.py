"""``lfcal camera sensor``: from folders of flats and darks to a camera with its measured sensor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from lfcal.base.errors import InputError
from lfcal.camera import Camera, preset
from lfcal.cli._app import build_app
from tests.frames.photon_transfer.sensor_model import Truth, micro_images

TRUTH = Truth(shape=(120, 160), dark_e_s=30.0)
EXPOSURES = (0.01, 0.03, 0.1, 0.2, 0.3)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """White images through lenslets and darks, two a level, exposures in their names or in those of their folders."""
    place = tmp_path_factory.mktemp("sensor")
    for name in ("flats", "darks/10ms", "darks/2s"):
        (place / name).mkdir(parents=True)
    for k, seconds in enumerate(EXPOSURES):
        light = seconds / 0.3 * 1.2 * TRUTH.full_e * micro_images(TRUTH.shape)
        for n in range(2):
            frame = TRUTH.frame(light, seconds, key=10 * k + n)
            tifffile.imwrite(place / "flats" / f"flat_{1000 * seconds:g}ms_{n}.tif", frame)
    for folder, seconds in (("10ms", 0.01), ("2s", 2.0)):
        for n in range(3):
            frame = TRUTH.frame(0.0, seconds, key=900 + int(seconds) * 10 + n)
            tifffile.imwrite(place / "darks" / folder / f"{n}.tif", frame)
    return place


def run(*words: object) -> tuple[int, str]:
    """Run the command; return exit code and standard output."""
    done = CliRunner().invoke(build_app(), ["camera", "sensor", *map(str, words)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout


def test_folders_become_a_camera_and_a_picture(folders: Path, tmp_path: Path) -> None:
    out, picture = tmp_path / "camera.json", tmp_path / "ptc.png"
    code, shown = run(
        folders / "flats",
        folders / "darks",
        *("--camera", "bench", "-o", out, "--figure", picture, "--workers", 2),
    )
    assert code == 0 and "e⁻ per count" in shown and str(out) in shown
    camera = Camera.from_json(out.read_text())
    assert camera.sensor.electrons_per_count == pytest.approx(5.0, rel=0.02)
    assert camera.sensor.read_noise_e == pytest.approx(8.0, rel=0.03)
    assert camera.sensor.dark_current_e_s == pytest.approx(30.0, rel=0.05)
    assert camera.sensor.linearity == pytest.approx(0, abs=0.002)
    assert camera.marks["sensor.full_well_e"] == camera.marks["sensor.linearity"] == "measured"
    assert camera.lattice == preset("bench").lattice and camera.marks["sensor.prnu"] == "stated"
    assert picture.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="--force"):
        run(folders / "flats", folders / "darks", "--camera", "bench", "-o", out)


def test_json_holds_values_errors_and_the_curve(folders: Path) -> None:
    _, text = run(folders / "flats", folders / "darks", "--json")
    found = json.loads(text)
    assert found["gain"]["value"] == pytest.approx(0.2, abs=5 * found["gain"]["sigma"])
    assert found["prnu"] is None and any("structure" in note for note in found["notes"])
    assert len(found["curve"]["signal"]) == len(found["curve"]["variance"]) > 20
    assert found["frames"] == {"flats": 10, "darks": 6}


def test_stacks_and_folders_of_folders_are_the_same_frames(folders: Path, tmp_path: Path) -> None:
    """Levels by folder, by page of a file without exposures, or by name: the same gain."""
    pages = []
    for k, seconds in enumerate(EXPOSURES):
        (tmp_path / "levels" / f"level{k}").mkdir(parents=True)
        for n in range(2):
            frame = tifffile.imread(folders / "flats" / f"flat_{1000 * seconds:g}ms_{n}.tif")
            tifffile.imwrite(tmp_path / "levels" / f"level{k}" / f"{n}.tif", frame)
            pages.append(frame)
    np.save(tmp_path / "flats.npy", np.stack(pages))
    by_name, by_folder, by_page = (
        json.loads(run(flats, folders / "darks", "--json")[1])
        for flats in (folders / "flats", tmp_path / "levels", tmp_path / "flats.npy")
    )
    assert by_name["gain"] == by_folder["gain"] == by_page["gain"]
    assert by_name["linearity"] is not None and by_folder["linearity"] is by_page["linearity"] is None


def test_doubtful_figures_are_shown_and_not_written(folders: Path, tmp_path: Path) -> None:
    for kind in ("flats", "darks"):
        (tmp_path / kind).mkdir()
        for file in sorted((folders / kind).rglob("*.tif")):
            values = np.clip((tifffile.imread(file).astype(float) - 40) / 4055, 0, 1)
            name = f"{file.parent.name}_{file.name}" if kind == "darks" else file.name
            tifffile.imwrite(tmp_path / kind / name, np.rint(255 * values ** (1 / 2.2)).astype(np.uint8))
    out = tmp_path / "camera.json"
    with pytest.raises(InputError, match="record raw"):
        run(tmp_path / "flats", tmp_path / "darks", "--camera", "bench", "-o", out)
    assert not out.exists()


def test_mistakes_are_one_line(folders: Path, tmp_path: Path) -> None:
    flats, darks = folders / "flats", folders / "darks"
    for words, said in (
        ((flats, flats), "no file that is in both"),
        ((darks, flats), "exchange flats and darks"),
        ((flats, darks, "-o", tmp_path / "c.json"), "--camera"),
        ((flats, darks, "--figure", tmp_path / "ptc.xyz"), ".png"),
        ((flats, darks, "--cfa", "RGX"), "letters"),
    ):
        with pytest.raises(InputError, match=said):
            run(*words)
    assert list(tmp_path.iterdir()) == []
