"""Centres of single lenslets from the discs of a white image, against discs drawn at known places."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.cli import main
from lfcal.lattice import fit_discs
from lfcal.simulate import SimulatedCamera

RNG = np.random.default_rng(3)


def camera_of(moved=0.0) -> Camera:
    camera = preset("flfm_20x05")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(600, 620), pixel_um=13.0))
    centres = np.array(camera.lattice.lens_centres_um) + moved
    return replace(camera, lattice=replace(camera.lattice, lens_centres_um=tuple(map(tuple, centres.tolist()))))


def white_of(camera: Camera, radius: float, square=False, falloff=0.3, noise=20.0) -> np.ndarray:
    """Draw discs with the exact share of light in each pixel, by 8 x 8 samples, darker towards their edges."""
    rows, columns = (np.arange(8 * n) / 8 + 1 / 16 - 0.5 for n in camera.sensor.shape)
    out = np.zeros((len(rows), len(columns)), np.float32)
    for row, column in camera.pixels(np.array(camera.lattice.lens_centres_um) + np.array(camera.lattice.offset_um)):
        near = np.ix_(np.abs(rows - row) < radius, np.abs(columns - column) < radius)
        y, x = np.abs(rows[near[0]] - row), np.abs(columns[near[1]] - column)
        far = np.maximum(y, x) if square else np.hypot(y, x)
        out[near] += np.where(far < radius, 1 - falloff * (far / radius) ** 2, 0.0).astype(np.float32)
    mean = out.reshape(camera.sensor.shape[0], 8, camera.sensor.shape[1], 8).mean((1, 3))
    return 4000.0 * mean + 100.0 + noise * np.random.default_rng(0).standard_normal(mean.shape)


@pytest.mark.parametrize(("radius", "square"), [(60.0, False), (95.5, False), (70.0, True)])
def test_centres_are_found_to_a_small_part_of_a_pixel(radius, square):
    true = camera_of(RNG.normal(0, 20, (7, 2)) + np.array([90.0, -60.0]))
    found = fit_discs(white_of(true, radius, square), camera_of())
    places = true.pixels(true.lattice.lens_centres_um)
    off = found.centres_px - places
    # all pixels along the side of a square are cut alike, so their errors do not average out
    assert np.abs(off).max() < (0.1 if square else 0.05)
    assert square or np.abs(off / found.errors_px[:, None]).max() < 5
    assert found.radii_px.min() > 0.9 * radius
    assert np.allclose(found.camera.lattice.lens_centres_um, true.lattice.lens_centres_um, atol=1.3)
    assert found.camera.marks["lattice.lens_centres_um"] == "measured"


def test_the_simulated_white_frame_of_touching_discs_gives_the_described_centres() -> None:
    camera = preset("flfm_20x05")
    white = SimulatedCamera(ScanPlan.for_camera(camera, depths_um=(0.0,), cutout=101), ()).white_frame()
    found = fit_discs(white, camera)
    assert np.allclose(found.camera.lattice.lens_centres_um, camera.lattice.lens_centres_um, atol=0.5)


def test_unusable_white_images_are_refused_in_one_sentence() -> None:
    camera, bench = camera_of(), preset("bench")
    fewer = replace(camera, lattice=replace(camera.lattice, lens_centres_um=camera.lattice.lens_centres_um[:5]))
    flat = np.full(camera.sensor.shape, 7.0)
    for frame, given, what in (
        (white_of(fewer, 60.0), camera, "expected 7, one for each lenslet of .*, got 5; correct the lenslet centres"),
        (flat, camera, "white image: expected bright discs on a dark background, got even light"),
        (np.zeros((50, 50)), camera, "use a whole frame of this camera"),
        (white_of(camera_of((0.0, -1300.0)), 60.0), camera, "its whole edge on the frame, got only a part of it"),
        (np.zeros(bench.sensor.shape), bench, "camera: expected a Fourier light-field microscope, got bench"),
    ):
        with pytest.raises(InputError, match=what):
            fit_discs(frame, given)


def test_the_command_writes_the_camera(tmp_path, monkeypatch, capsys):
    true = camera_of((26.0, 13.0))
    path, start = tmp_path / "white.png", tmp_path / "camera.json"
    cv2.imwrite(str(path), np.clip(white_of(true, 60.0), 0, 65535).astype(np.uint16))
    start.write_text(camera_of().to_json())
    monkeypatch.setattr("sys.argv", ["lfcal", "white", str(path), "--camera", str(start), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code and "lenslet 6" in capsys.readouterr().out
    written = Camera.from_dict(json.loads((tmp_path / "out" / "camera.json").read_text()))
    assert np.allclose(written.lattice.lens_centres_um, true.lattice.lens_centres_um, atol=0.7)
    assert [one.name for one in (tmp_path / "out").iterdir()] == ["camera.json"]
    monkeypatch.setattr("sys.argv", ["lfcal", "white", str(path), "--camera", str(start), "--pitch", "20"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "--pitch: expected a camera with a periodic lenslet array" in capsys.readouterr().err
