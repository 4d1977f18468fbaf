from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gui.models.project import ProjectState
from gui.pages.multiplex.model import MultiplexSettings, choices_to_compare, picture, used_by
from gui.pages.multiplex.model_compare import compare, number
from gui.pages.multiplex.model_scene import Reconstructions, iter_reconstruct, noisy, opened, rms_error, scene_of, shown
from lfcal.camera import Sensor
from lfcal.errors import FileFormatError, InputError
from lfcal.multiplex import cfa, demultiplex, mask, multiplex, snr_gain
from lfcal.progress import drain

SENSOR = Sensor(full_well_e=10_000, read_noise_e=10)


def reconstruct(settings: MultiplexSettings) -> Reconstructions:
    return drain(iter_reconstruct(settings, SENSOR))


def test_settings_survive_a_saved_session_and_damaged_ones_take_defaults() -> None:
    settings = MultiplexSettings(family="both", cfa="typed", pattern="RGB/GBR", size=5, compared=("lenslet",))
    state = ProjectState(settings={"other": 1})
    again = ProjectState.from_json(replace(state, settings=settings.into(state)).to_json())
    assert MultiplexSettings.of(again) == settings and again.settings["other"] == 1
    for damage in ({"size": "big"}, {"pattern": "QQ"}, {"family": 3}, "nothing", {"mask": "MURA", "size": 4}):
        assert MultiplexSettings.of(ProjectState(settings={"multiplex": damage})) == MultiplexSettings()
    json.dumps(dict(MultiplexSettings().into(state)))


@pytest.mark.parametrize(
    ("key", "value", "word"),
    [
        ("pattern", "RGX", "colour filter pattern"),
        ("size", 4, "odd prime"),
        ("size", 99, "1 to 31"),
        ("gain", 0, "gain"),
        ("scene", "moon", "scene"),
        ("right", "frame", "right"),
    ],
)
def test_what_cannot_be_is_refused_in_words(key: str, value: object, word: str) -> None:
    with pytest.raises(InputError, match=word):
        MultiplexSettings().changed(key, value)


def test_a_mask_without_this_size_takes_the_next() -> None:
    even = MultiplexSettings(mask="lenslet", size=10)
    assert even.changed("mask", "MURA").size == 11 and even.changed("mask", "pinhole").size == 10


def test_pictures_are_the_library_s() -> None:
    found = picture(MultiplexSettings(cfa="typed", pattern="GRBG"))
    assert found.colours is not None and found.real
    np.testing.assert_array_equal(found.colours[0], [[0, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(found.sigma, cfa("GRBG").spatial)
    np.testing.assert_array_equal(found.pi, cfa("GRBG").plenoptic)
    mura = picture(MultiplexSettings(family="mask", size=5))
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
    assert high.curves is not None and high.curves.chi2[-1] > high.chi2 > 1e4, "quantisation is left"


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
    assert found.truth is not None
    np.testing.assert_array_equal(shown(found, 1, "truth")[2], found.truth[1])


def test_the_fourier_route_is_the_sinc_and_smooth_scenes_come_back() -> None:
    found = reconstruct(MultiplexSettings(cfa="Bayer", filter="sinc", scene="smooth"))
    np.testing.assert_allclose(found.spatial.samples, found.fourier.samples, atol=1e-9)
    rough = reconstruct(MultiplexSettings(cfa="Bayer", filter="nearest", scene="smooth"))
    assert found.spatial.error is not None and rough.spatial.error is not None
    assert found.spatial.error < rough.spatial.error
    assert all(picture.shape[-1] == 3 for picture in shown(found, -1, "truth"))


def test_camera_noise_has_the_camera_s_variance() -> None:
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


def test_too_large_a_light_field_is_refused_in_words() -> None:
    with pytest.raises(InputError, match="built-in scene"):
        scene_of("edges", mask("lenslet", 31))


def test_stokes_parameters_are_shown_as_light() -> None:
    found = picture(MultiplexSettings(family="written"))
    assert found.colours is None
    np.testing.assert_allclose(found.pattern, 0.5)
    rows = {name: value for name, value, _ in compare(MultiplexSettings(family="written"), SENSOR).rows}
    assert rows["Transmission τ"] == "0.5" and "dB" in rows["Gain, own noise"] and "Colour error" not in rows
    same = MultiplexSettings(family="written", reference_written="polarisers:0,60,120")
    rows = {name: value for name, value, _ in compare(same, SENSOR).rows}
    assert rows["Gain, photon noise"] == "+0.00 dB", "rounding has no sign"
    with pytest.raises(InputError, match="entries"):
        MultiplexSettings(family="written", written="MURA:29").modulator()
    for key, value in (("figure", 4), ("search_size", 50), ("crosstalk", 0.9), ("sought", "gold")):
        with pytest.raises(InputError):
            replace(MultiplexSettings(), **{key: value})
