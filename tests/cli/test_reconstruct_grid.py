"""Frames go onto H's period by a lenslet of the type that H counts from, wherever the frame's middle lies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor, preset
from lfcal.lattice import fit_lattice, save_lattice
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import LightFieldSettings, Projector, SolverChoice, reconstruct
from lfcal.reconstruct.resample import resampling_for, resampling_of
from tests.cli.conftest import Run
from tests.lattice.white_frames import WhiteFrame, draw_white

PITCH = 16.0


def drawn(phase: int) -> tuple[WhiteFrame, PSFMatrix]:
    """Return a white frame whose lenslet of type ``phase`` lies in the middle, and an H of its camera."""
    truth = draw_white((330, 400), pitch=PITCH, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.0, phase=phase, dark=0.0)
    middle = (np.array(truth.frame.shape) - 1) / 2
    # the place of a lenslet of type 0, as the description knows it
    row, column = (np.array([phase, 0]) @ truth.basis)[::-1] + np.array(truth.origin) - middle
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 5 * PITCH, 400.0, types, offset_um=(5 * column, 5 * row))
    camera = Camera("c", MainLens(), lattice, Sensor(truth.frame.shape, 5.0))
    return truth, PSFMatrix(np.ones((1, 28, 48, 3, 3)), depths=[-500.0], camera=camera, anchor=(100.0, 120.0))


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("phase", [0, 1, 2])
def test_the_origin_is_a_lenslet_of_type_0(tmp_path: Path, phase: int) -> None:
    truth, H = drawn(phase)
    white = tmp_path / "white.tif"
    tifffile.imwrite(white, truth.frame)
    save_lattice(fit_lattice(truth.frame), tmp_path)
    for view in (
        resampling_of(H, LightFieldSettings(white=white)),
        resampling_of(H, LightFieldSettings(lattice=tmp_path / "lattice.json")),
    ):
        ((q, r),) = truth.indices(np.array([view.origin]))
        assert truth.distance_to_lattice(view.origin) < 0.05
        assert (q - r - phase) % 3 == 0


def test_a_white_frame_of_another_sensor_is_refused(tmp_path: Path) -> None:
    truth, H = drawn(0)
    tifffile.imwrite(tmp_path / "white.tif", truth.frame[:-20])
    with pytest.raises(InputError, match="white image"):
        resampling_of(H, LightFieldSettings(white=tmp_path / "white.tif"))


# -- what is resampled where nothing is asked for ------------------------------------------------------------
SHAPE = (130, 136)


@pytest.fixture
def drifting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PSFMatrix:
    """Write H of lenslets of 15.385 px, its period 15, and a frame of the whole sensor: 3.46 px of drift."""
    monkeypatch.chdir(tmp_path)
    camera = preset("lfm_60x12")
    camera = replace(camera, sensor=replace(camera.sensor, shape=SHAPE))
    rng = np.random.default_rng(0)
    H = PSFMatrix(rng.random((1, 15, 15, 5, 5)).astype(np.float32), depths=[1.0], camera=camera, anchor=(60.0, 63.0))
    save(H, "H.h5")
    for name, shape in (("frame.tif", SHAPE), ("part.tif", (100, 90))):
        tifffile.imwrite(name, rng.poisson(80, shape).astype(np.uint16))
    tifffile.imwrite("flat.tif", np.full(SHAPE, 1000, np.uint16))
    return H


def solved(lfcal: Callable[..., Run], *words: object) -> tuple[NDArray[Any], str]:
    """Return the volume that the command writes, and what it reports."""
    done = lfcal("reconstruct", "H.h5", *words, "--solver", "rl", "-n", 2, "--margin", 0, "--force", "-o", "v.npy")
    assert done.code == 0, done.err
    return np.load("v.npy"), done.err


@pytest.mark.parametrize("run", [(), ("--executor", "threads")])
def test_frames_are_resampled_where_the_lattice_drifts(
    lfcal: Callable[..., Run], drifting: PSFMatrix, run: tuple[str, ...]
) -> None:
    """They were reconstructed as they are, without a word; a white image without lenslets changes nothing."""
    asked, _ = solved(lfcal, "frame.tif", "--resample", "always", *run)
    usual, said = solved(lfcal, "frame.tif", *run)
    np.testing.assert_array_equal(usual, asked)
    view = resampling_for(drifting, SHAPE)
    assert view is not None and usual.shape == (1, *view.shape) != (1, *SHAPE)
    drift = 135 * (15.384615 / 15 - 1)
    assert f"drifts by {drift:.3g} px over the frame relative to H's period of 15 x 15 px; frames are resampled" in said
    flat, said = solved(lfcal, "frame.tif", "--white", "flat.tif", *run)
    assert (
        flat.shape == usual.shape
        and "the lattice could not be measured in the white image" in said
        and "resampled" in said
    )


def test_frames_are_used_as_they_are_where_that_is_asked_for(lfcal: Callable[..., Run], drifting: PSFMatrix) -> None:
    found, said = solved(lfcal, "frame.tif", "--resample", "never")
    image = tifffile.imread("frame.tif").astype(np.float32)
    P = Projector(drifting, SHAPE)
    result = reconstruct(P, image, SolverChoice("rl", 2))
    np.testing.assert_allclose(found, result.volume, rtol=1e-5)
    assert "warning: the lattice drifts by 3.46 px over the frame" in said and "leave --resample never out" in said
    assert any("drifts by 3.46 px" in note and "resampling_for" in note for note in result.notes)
    # a frame whose place is given, or of another size, is not moved
    placed, said = solved(lfcal, "frame.tif", "--anchor", "60,63")
    np.testing.assert_array_equal(placed, found)
    assert "warning: the lattice drifts by 3.46 px" in said and "--anchor" in said
    part, said = solved(lfcal, "part.tif")
    assert part.shape == (1, 100, 90) and "drift" not in said


def test_frames_that_keep_step_are_used_as_they_are(lfcal: Callable[..., Run], drifting: PSFMatrix) -> None:
    """Up to half a pixel of drift; a white image that shows more decides against the camera."""
    camera = drifting.camera
    assert camera is not None
    pitch = 15.02 * camera.sensor.pixel_um
    fitting = replace(camera, lattice=replace(camera.lattice, pitch_um=pitch))
    Path("H.h5").unlink()
    save(PSFMatrix(drifting[:], depths=[1.0], camera=fitting, anchor=drifting.anchor), "H.h5")
    found, said = solved(lfcal, "frame.tif")
    assert found.shape == (1, *SHAPE) and "drift" not in said
    white = draw_white(SHAPE, 15.4, kind="square", rotation=0.0).frame
    tifffile.imwrite("white.tif", white)
    found, said = solved(lfcal, "frame.tif", "--white", "white.tif")
    assert found.shape != (1, *SHAPE) and "frames are resampled" in said
