from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import FileFormatError, InputError, drain
from lfcal.camera import Camera, LatticeDistortion, Sensor, preset
from lfcal.lattice import fit_lattice, lattice_of
from lfcal.multiplex import (
    cfa,
    demultiplex,
    demultiplex_generally,
    demultiplex_lattice,
    demultiplex_weighted,
    mask,
    multiplex,
    pixel_weights,
    snr_gain,
)
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.multiplex.model import MultiplexSettings, choices_to_compare, picture, used_by, why_unused
from lfcal_gui.pages.multiplex.model_compare import compare, number
from lfcal_gui.pages.multiplex.model_scene import (
    Reconstructions,
    iter_reconstruct,
    measured_in,
    noisy,
    opened,
    rms_error,
    scene_of,
    shown,
    white_of,
)

SENSOR = Sensor(full_well_e=10_000, read_noise_e=10)


def reconstruct(settings: MultiplexSettings) -> Reconstructions:
    return drain(iter_reconstruct(settings, SENSOR))


REFUSED: tuple[tuple[str, object, str], ...] = (
    *(("pattern", "RGX", "colour filter pattern"), ("size", 4, "odd prime"), ("size", 99, "1 to 31")),
    *(("gain", 0, "gain"), ("scene", "moon", "Scene"), ("right", "frame", "right"), ("route", "scenic", "Route")),
    *(("spacing", 0.1, "node spacing"), ("smoothness", -1.0, "smoothness"), ("figure", 4, ""), ("sought", "gold", "")),
    *(("search_size", 50, ""), ("crosstalk", 0.9, "")),
)


def test_what_cannot_be_is_refused_in_words() -> None:
    for key, value, word in REFUSED:
        with pytest.raises(InputError, match=word or None):
            MultiplexSettings().changed(key, value)
    even = MultiplexSettings(mask="lenslet", size=10)
    assert even.changed("mask", "MURA").size == 11, "a mask without this size takes the next"
    assert even.changed("mask", "pinhole").size == 10
    with pytest.raises(InputError, match=r"matrix of sum of sinusoids over .*; reduce Size, or choose other filters"):
        MultiplexSettings(family="both", mask="sum_of_sinusoids", size=31).modulator()
    with pytest.raises(InputError, match="built-in scene"):
        scene_of("edges", mask("lenslet", 31))


def test_pictures_are_the_library_s() -> None:
    found = picture(MultiplexSettings(cfa="typed", pattern="GRBG"))
    assert found.colours is not None and found.real
    np.testing.assert_array_equal(found.colours[0], [[0, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(found.sigma, cfa("GRBG").spatial)
    np.testing.assert_array_equal(found.pi, cfa("GRBG").plenoptic)
    mura = picture(MultiplexSettings(family="mask", size=5))
    assert mura.pattern.min() == 0.0, "rounding errors gave its scale a sign"
    assert mura.colours is None and not mura.real and mura.sigma.shape == (25, 25)
    np.testing.assert_allclose(mura.spectrum[2, 2], mura.pattern.mean())


def test_numbers_and_curves_are_the_library_s() -> None:
    found = compare(MultiplexSettings(gain=4.0), SENSOR, "mine")
    assert found.chi2 == pytest.approx(25, rel=1e-3) and found.curves is not None
    gain = snr_gain(cfa("CYMG"), cfa("Bayer"), 25.0)
    rows = {name: value for name, value, _ in found.rows}
    assert rows["Gain at χ² = 25"] == f"{gain:+.2f} dB".replace("-", "−")
    assert rows["Transmission τ"] == "0.5833" and rows["Amplification α"] == f"{math.sqrt(13 / 21):.4g}"
    assert rows["Not recoverable"] == "nothing" and found.curves.names[0] == "CYMG"
    np.testing.assert_allclose(found.curves.gains[0], snr_gain(cfa("CYMG"), cfa("Bayer"), found.curves.chi2))
    high = compare(MultiplexSettings(), replace(SENSOR, read_noise_e=0.0, bit_depth=16))
    assert high.curves.chi2[-1] > high.chi2 > 1e4, "quantisation is left"


def test_what_is_lost_is_named_and_not_drawn() -> None:
    found = compare(MultiplexSettings(cfa="typed", pattern="RG/RG"), SENSOR)
    assert found.left_out == ("RG/RG",) and dict(row[:2] for row in found.rows)["Not recoverable"] == "B 100 %"
    even = compare(MultiplexSettings(family="both", mask="lenslet", size=4), SENSOR)
    assert even.curves is None and "rank 48" in even.reason
    assert "and 40 more" in dict(row[:2] for row in even.rows)["Not recoverable"]
    names = [m.name for m in MultiplexSettings(family="mask", mask="lenslet", size=4).others()]
    assert names == ["lenslet"], "no MURA and no sinusoids of 4 px"
    assert number(None) == "–" and number(-math.inf) == "−∞"


def test_only_what_matters_is_offered() -> None:
    one = MultiplexSettings()
    assert used_by(one, "cfa") and not used_by(one, "pattern") and not used_by(one, "mask") and used_by(one, "gain")
    assert used_by(replace(one, cfa="typed"), "pattern") and used_by(replace(one, family="both"), "size")
    for scene in ("image", "live"):
        seen = replace(one, scene=scene)
        assert used_by(seen, "filter") and not why_unused(seen, "filter")
        for weighed in (replace(seen, weighted=True), replace(seen, dead="dead.npy")):
            assert not used_by(weighed, "filter") and "linear" in why_unused(weighed, "filter")
    assert used_by(replace(one, weighted=True, dead="dead.npy"), "filter"), "built-in scenes have no weights"
    coloured = replace(one, scene="image", weighted=True)
    assert used_by(coloured, "filter", colour=True) and not used_by(coloured, "weighted", colour=True)
    assert not used_by(replace(coloured, dead="dead.npy"), "filter", colour=True)
    general = replace(one, scene="live", weighted=True, route="general")
    assert not used_by(general, "filter") and not why_unused(general, "filter")
    assert "Bayer" in choices_to_compare("cfa") and "MURA" in choices_to_compare("both")


@pytest.mark.parametrize("family", ["cfa", "mask", "both"])
def test_reconstructions_are_the_library_s(family: str) -> None:
    settings = MultiplexSettings(family=family, cfa="Bayer", mask="lenslet", size=3, filter="linear")
    found, modulator = reconstruct(settings), settings.modulator()
    scene = scene_of("edges", modulator)
    frame = multiplex(scene, modulator)
    np.testing.assert_array_equal(found.frame, frame)
    for route in (found.spatial, found.fourier):
        name = "fourier" if route is found.fourier else "spatial"
        expected = demultiplex(frame, modulator, route=name, filter="linear", samples=modulator.side)
        np.testing.assert_allclose(route.samples, expected, atol=1e-12)
        assert route.error == pytest.approx(rms_error(expected, scene, modulator.side)) and "% rms" in route.words
    left, middle, difference = shown(found, 1, "difference")
    np.testing.assert_array_equal(difference, left - middle)
    np.testing.assert_array_equal(shown(found, 1, "truth")[2], found.truth[1])


def test_the_fourier_route_is_the_sinc_and_noise_has_the_variance_of_the_camera() -> None:
    found = reconstruct(MultiplexSettings(cfa="Bayer", filter="sinc", scene="smooth"))
    np.testing.assert_allclose(found.spatial.samples, found.fourier.samples, atol=1e-9)
    rough = reconstruct(MultiplexSettings(cfa="Bayer", filter="nearest", scene="smooth"))
    assert found.spatial.error is not None and rough.spatial.error is not None
    assert found.spatial.error < rough.spatial.error
    assert all(picture.shape[-1] == 3 for picture in shown(found, -1, "truth"))
    frame = np.full((200, 200), 0.5)
    seen = noisy(frame, SENSOR, 2.0, np.random.default_rng(0))
    assert seen.std() == pytest.approx(0.5 * math.sqrt(5000 + 100) / 5000, rel=0.02)
    assert "camera noise" in reconstruct(MultiplexSettings(cfa="Bayer", noise=True)).words


def test_opened_images_are_frames_or_scenes(tmp_path: Path) -> None:
    import cv2

    rng = np.random.default_rng(0)
    grey, colour = rng.integers(0, 4000, (30, 40), np.uint16), rng.integers(0, 255, (24, 26, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    cv2.imwrite(str(tmp_path / "colour.png"), colour)
    found = reconstruct(MultiplexSettings(cfa="Bayer", scene="image", image=str(tmp_path / "grey.png")))
    np.testing.assert_array_equal(found.frame, grey)
    assert found.truth is None and found.spatial.error is None and "40 × 30 px" in found.words
    np.testing.assert_array_equal(shown(found, 0, "truth")[2], found.spatial.samples[0] - found.fourier.samples[0])
    lens = MultiplexSettings(family="mask", mask="lenslet", size=5, scene="image", image=str(tmp_path / "grey.png"))
    assert reconstruct(lens).spatial.samples.shape == (25, 6, 8) and reconstruct(lens).step == 5
    scene, frame, _ = opened(str(tmp_path / "colour.png"))
    assert frame is None and scene is not None
    np.testing.assert_allclose(scene, np.moveaxis(colour[..., ::-1], -1, 0) / colour.max(), rtol=1e-6)
    with pytest.raises(InputError, match="grey frame"):
        reconstruct(replace(lens, image=str(tmp_path / "colour.png")))
    (tmp_path / "bad.tif").write_bytes(b"nothing")
    with pytest.raises(FileFormatError):
        opened(str(tmp_path / "bad.tif"))


def test_stokes_parameters_are_shown_as_light() -> None:
    found = picture(MultiplexSettings(family="written"))
    assert found.colours is None
    np.testing.assert_allclose(found.pattern, 0.5)
    rows = {name: value for name, value, _ in compare(MultiplexSettings(family="written"), SENSOR).rows}
    assert rows["Transmission τ"] == "0.5" and "dB" in rows["Gain, plain"] and "Colour error" not in rows
    same = MultiplexSettings(family="written", reference_written="polarisers:0,60,120")
    rows = {name: value for name, value, _ in compare(same, SENSOR).rows}
    assert rows["Gain, photon noise"] == "+0.00 dB", "rounding has no sign"
    with pytest.raises(InputError, match="entries"):
        MultiplexSettings(family="written", written="MURA:29").modulator()


def on_lattice(folder: Path, frame: np.ndarray, **changes: Any) -> MultiplexSettings:
    """Return settings for a MURA mask on the lattice of a camera, in front of a frame."""
    files = saved(folder, image=frame)
    settings = MultiplexSettings(family="mask", size=5, route="lattice", filter="linear", scene="image", **files)
    return replace(settings, **changes)


def dice(camera: Camera) -> np.ndarray:
    return np.random.default_rng(6).random(camera.sensor.shape).astype(np.float32)


def saved(folder: Path, **arrays: object) -> dict[str, str]:
    for name, array in arrays.items():
        np.save(folder / f"{name}.npy", np.asarray(array))
    return {name: str(folder / f"{name}.npy") for name in arrays}


def test_the_general_route_takes_masks_that_do_not_repeat(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    shares, frame = rng.random((2, 30, 40)), rng.random((30, 40)).astype(np.float32)
    dead = np.zeros((30, 40), np.uint8)
    dead[3:6, 7] = 1
    files = saved(tmp_path, shares=shares, image=frame, dead=dead)
    settings = MultiplexSettings(scene="image", route="general", image=files["image"], spacing=2.0, smoothness=1e-3)
    settings = replace(settings, transmissions=files["shares"], dead=files["dead"])
    found = reconstruct(settings)
    wanted = demultiplex_generally(frame, shares, 2.0, weights=dead == 0, smoothness=1e-3)
    np.testing.assert_allclose(found.spatial.samples, wanted.samples, atol=1e-9)
    assert found.fourier is None and found.names == ("sample 0", "sample 1") and found.step == 2
    assert f"{wanted.iterations} iterations" in found.words
    left, second, third = shown(found, 1, "difference")
    assert second is None and third is None
    np.testing.assert_array_equal(left, found.spatial.samples[1])
    assert np.abs(reconstruct(replace(settings, dead="")).spatial.samples - wanted.samples).max() > 1e-3
    assert reconstruct(replace(settings, spacing=None)).spatial.samples.shape == (2, 21, 28), "as many as are measured"
    for key, array in (("dead", dead[1:]), ("transmissions", shares[:, 1:]), ("transmissions", frame)):
        with pytest.raises(InputError, match=key.split("_")[0]) as refused:
            reconstruct(replace(settings, **{key: saved(tmp_path, other=array)["other"]}))
        assert "\n" not in str(refused.value)


def test_what_the_general_route_cannot_solve_is_refused(tmp_path: Path) -> None:
    frame = np.ones((1100, 600), np.float32)
    settings = MultiplexSettings(scene="image", route="general", **saved(tmp_path, image=frame))
    with pytest.raises(InputError, match="up to 96 for this frame"):
        reconstruct(replace(settings, family="mask", size=11))
    gaps = saved(tmp_path, transmissions=np.full((3, 50, 50), np.nan))
    for noise in (False, True):
        with pytest.raises(InputError, match="transmissions: expected finite numbers"):
            reconstruct(MultiplexSettings(route="general", noise=noise, **gaps))
    every = saved(tmp_path, dead=np.ones((12, 12), np.uint8), image=frame[:12, :12])
    for route in ("general", "cells"):
        with pytest.raises(InputError, match="weight"):
            reconstruct(replace(settings, route=route, **every))


def test_the_general_route_of_scenes_knows_the_truth(tmp_path: Path) -> None:
    found = reconstruct(MultiplexSettings(cfa="Bayer", route="general", spacing=1.0))
    assert found.truth is not None and found.spatial.error is not None and found.spatial.error < 0.05
    np.testing.assert_array_equal(shown(found, 1, "difference")[2], found.truth[1])
    own = saved(tmp_path, shares=np.random.default_rng(5).random((1, 60, 80)) + 0.1)
    found = reconstruct(MultiplexSettings(route="general", transmissions=own["shares"], spacing=1.0, smoothness=1e-9))
    assert found.truth is not None
    np.testing.assert_allclose(found.spatial.samples, found.truth, atol=1e-4)
    assert found.spatial.error is not None and found.spatial.error < 1e-4


def test_dead_and_clipped_pixels_by_super_pixels(tmp_path: Path) -> None:
    frame, dead = np.full((24, 30), 300.0, np.float32), np.zeros((24, 30), np.uint8)
    frame[5, 6], dead[5, 6] = 9e3, 1
    files = saved(tmp_path, image=frame, dead=dead)
    settings = MultiplexSettings(cfa="Bayer", scene="image", **files)
    found = reconstruct(settings)
    np.testing.assert_allclose(found.spatial.samples, demultiplex_weighted(frame, cfa("Bayer"), 1.0 - dead).samples)
    np.testing.assert_allclose(found.spatial.samples, 300, rtol=1e-5)
    assert found.fourier.samples.max() > 400, "the Fourier route has no weights"
    dark = replace(SENSOR, black_level=40.0)
    weighted = drain(iter_reconstruct(replace(settings, weighted=True), dark))
    weights = pixel_weights(frame, dark, dead=dead)
    wanted = demultiplex_weighted(frame - 40, cfa("Bayer"), weights).samples
    np.testing.assert_allclose(weighted.spatial.samples, wanted, rtol=1e-5)


def test_masks_on_the_camera_s_own_lattice(tmp_path: Path) -> None:
    camera = preset("bench")
    frame = dice(camera)
    settings = on_lattice(tmp_path, frame)
    found = drain(iter_reconstruct(settings, camera.sensor, camera=camera))
    for route, made in (("spatial", found.spatial), ("fourier", found.fourier)):
        wanted = demultiplex_lattice(frame, lattice_of(camera), mask("MURA", 5), route=route)
        np.testing.assert_allclose(made.samples, wanted, rtol=1e-5, atol=1e-5)
    assert found.origin is not None and "lattice of bench" in found.words
    part = frame[7:207, 5:225]
    live = drain(iter_reconstruct(replace(settings, scene="live"), camera.sensor, (part, (7, 5)), camera))
    lattice = lattice_of(camera, (197, 220), (10, 5))
    light = frame[10:207, 5:225] - np.float32(camera.sensor.black_level)
    wanted = demultiplex_lattice(light, lattice, mask("MURA", 5))
    np.testing.assert_allclose(live.spatial.samples, wanted, rtol=1e-4, atol=1e-4)
    with pytest.raises(InputError, match="project's camera"):
        drain(iter_reconstruct(on_lattice(tmp_path, part), camera.sensor, camera=camera))


def test_built_in_scenes_behind_masks_on_the_lattice() -> None:
    camera = preset("bench")
    settings = MultiplexSettings(family="mask", mask="lenslet", size=3, route="lattice")
    found = drain(iter_reconstruct(settings, camera.sensor, camera=camera))
    assert found.truth.shape == found.spatial.samples.shape
    assert found.fourier is not None
    for made, least in ((found.spatial, 0.85), (found.fourier, 0.95)):
        assert np.corrcoef(made.samples.ravel(), found.truth.ravel())[0, 1] > least
    with pytest.raises(InputError, match="super-pixel"):
        drain(iter_reconstruct(replace(settings, family="cfa"), camera.sensor, camera=camera))
    large, wide = replace(settings, mask="MURA", size=31), preset("r29")
    with pytest.raises(InputError, match="mask for a built-in scene"):
        drain(iter_reconstruct(large, wide.sensor, camera=wide))


@pytest.mark.long
def test_the_lattice_is_measured_where_the_project_has_a_white_image(tmp_path: Path) -> None:
    camera = preset("bench")
    y, x = np.indices(camera.sensor.shape)
    away = lattice_of(camera).lenslet_at(y - 0.4, x + 0.3)
    away = away - np.rint(away)
    white = np.rint(100 + 2000 * np.exp(-12 * (away**2).sum(-1))).astype(np.uint16)
    (folder := tmp_path / "white").mkdir()
    np.save(folder / "white.npy", white)
    frame = dice(camera)
    settings = on_lattice(tmp_path, frame)
    project = ProjectState(camera=camera, settings=FrameSettings(white=str(folder)).into(ProjectState()))
    project = replace(project, settings=settings.into(project))
    measured = replace(settings, white=white_of(project))
    assert measured.white and measured_in(project) == str(folder)
    found = drain(iter_reconstruct(measured, camera.sensor, camera=camera))
    assert "lattice measured in white" in found.words
    wanted = demultiplex_lattice(frame, fit_lattice(white), mask("MURA", 5))
    np.testing.assert_allclose(found.spatial.samples, wanted, atol=1e-4)
    # of another size it is no white image of this frame: that of Record > Folder is left out, the page's own refused
    small = replace(measured, image=saved(tmp_path, small=frame[:300])["small"])
    for other, word in ((small, "project's camera"), (replace(small, white=str(folder)), "white image")):
        with pytest.raises(InputError, match=word):
            drain(iter_reconstruct(other, camera.sensor, camera=camera))
    for marks, word in ((camera.marks, "stated"), (camera.marks.marked(["lattice.pitch_um"], "measured"), "measured")):
        known = replace(camera, marks=marks)
        assert f"lattice of bench, {word}" in drain(iter_reconstruct(settings, camera.sensor, camera=known)).words


def test_a_bent_lattice_has_no_fourier_route_and_says_so(tmp_path: Path) -> None:
    camera = preset("bench")
    bend = LatticeDistortion("radial", (0.0, 0.0), 300.0, ((2.0,),))
    bent = replace(camera, lattice=replace(camera.lattice, distortion=bend))
    frame = dice(camera)
    found = drain(iter_reconstruct(on_lattice(tmp_path, frame), camera.sensor, camera=bent))
    assert found.fourier is None and "rows are bent" in found.words
    wanted = demultiplex_lattice(frame, lattice_of(bent), mask("MURA", 5))
    np.testing.assert_allclose(found.spatial.samples, wanted, rtol=1e-5, atol=1e-5)


def test_dead_pixels_on_a_lattice_and_no_numbers(tmp_path: Path) -> None:
    camera = preset("bench")
    frame, dead = np.ones(camera.sensor.shape, np.float32), np.zeros(camera.sensor.shape, np.uint8)
    frame[100:104, 200], dead[100:104, 200] = np.nan, 1
    files = saved(tmp_path, image=frame, dead=dead)
    for route in ("lattice", "cells"):
        settings = MultiplexSettings(family="mask", mask="lenslet", size=5, route=route, scene="image", **files)
        found = drain(iter_reconstruct(settings, camera.sensor, camera=camera))
        assert found.spatial.name == "Spatial, weighted" and found.fourier is not None
        np.testing.assert_allclose(found.spatial.samples, 1 / 25, rtol=1e-6)
        assert np.isfinite(found.fourier.samples).all() and found.fourier.samples.min() < 0.039


def test_the_black_level_that_a_file_states_is_subtracted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import lfcal.frames

    frame = np.random.default_rng(1).integers(300, 4000, (240, 241)).astype(np.uint16)
    files, open_image = saved(tmp_path, image=frame), lfcal.frames.open_image

    def stating(*args: Any, **options: Any) -> Any:
        image = open_image(*args, **options)
        stated = {**image.metadata, "cfa": "GRBG", "black_level": (10.0, 20.0, 30.0, 40.0)}
        object.__setattr__(image, "metadata", stated)
        return image

    monkeypatch.setattr(lfcal.frames, "open_image", stating)
    # a larger frame is worked on in its middle
    monkeypatch.setattr("lfcal_gui.pages.multiplex.model_scene.LARGEST", 176)
    settings = MultiplexSettings(cfa="typed", pattern="GRBG", scene="image", weighted=True, **files)
    found = reconstruct(settings)
    light = frame - np.tile([[10.0, 20.0], [30.0, 40.0]], (120, 121))[:, :241]
    middle = np.s_[32 : 32 + 176, 32 : 32 + 176]
    np.testing.assert_array_equal(found.frame, light[middle])
    level = (10.0, 20.0, 30.0, 40.0)
    weights = pixel_weights(frame, SENSOR, black_level=level)[middle]
    wanted = demultiplex_weighted(light[middle], cfa("GRBG"), weights).samples
    np.testing.assert_allclose(found.spatial.samples, wanted, rtol=1e-5)
