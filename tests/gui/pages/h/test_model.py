"""What the place H shows of H, HT, another H and the aperture, without a window."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base import format_plane
from lfcal.camera import preset
from lfcal.judge import pair
from lfcal.psf import PSFMatrix, transpose
from lfcal.psf.aperture import Aperture, fit_aperture
from lfcal_gui.pages.h.model import (
    HIntent,
    LoadedPlane,
    aperture_tip,
    aperture_words,
    linked_pixel,
    place_words,
    read_plane,
    resolve,
    turn_pixel,
)

SHAPE = (3, 4, 5, 7, 9)


def plane() -> LoadedPlane:
    return LoadedPlane(1, np.random.default_rng(0).random(SHAPE[1:]).astype(np.float32))


@given(st.tuples(*(st.integers(0, n - 1) for n in SHAPE[1:])))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_linked_pixels_hold_the_same_entry(index: tuple[int, int, int, int]) -> None:
    y, x, t, s = index
    H = plane().values
    HT = transpose(H[None])[0]
    there, mark = linked_pixel((y, x), (t, s), SHAPE[1:3], SHAPE[3:])
    assert HT[there][mark] == H[index]
    assert linked_pixel(there, mark, SHAPE[1:3], SHAPE[3:]) == ((y, x), (t, s))
    wrong = (there[1] % 4, there[0] % 5)
    assert wrong == there or HT[wrong][mark] != H[index]


@pytest.mark.parametrize("transposed", [False, True])
def test_the_picture_follows_the_intent(transposed: bool) -> None:
    loaded = plane()
    H, HT = loaded.values, transpose(loaded.values[None])[0]
    main, other = (HT, H) if transposed else (H, HT)
    intent = HIntent(1, 2, 3, transposed)
    picture = resolve(intent, loaded)
    np.testing.assert_array_equal(picture.main, main[2, 3])
    np.testing.assert_array_equal(picture.linked, other[2, 3])
    assert picture.main_cursor is None and picture.linked_cursor is None
    picture = resolve(replace(intent, pixel=(1, 4)), loaded)
    assert picture.linked_cursor is not None
    assert picture.linked[picture.linked_cursor] == picture.main[1, 4]
    np.testing.assert_array_equal(picture.linked, other[picture.linked_position])


def test_differences_are_at_equal_energy() -> None:
    loaded = plane()
    H, other = PSFMatrix(loaded.values[None]), PSFMatrix(2 * loaded.values[None])
    data = read_plane(H, pair(H, other), 0)
    assert data.reference.scale == pytest.approx(0.5)
    picture = resolve(HIntent(view="difference"), data.plane, data.reference)
    assert picture.signed and np.abs(picture.linked).max() < 1e-6
    np.testing.assert_array_equal(picture.main, loaded.values[0, 0])
    shown = resolve(HIntent(show="reference"), data.plane, data.reference).main
    np.testing.assert_array_equal(shown, 2 * loaded.values[0, 0])


def test_another_h_is_paired_by_depth_and_cut_to_the_pixels_of_both() -> None:
    values = np.random.default_rng(0).random((2, 4, 5, 7, 9)).astype(np.float32)
    H = PSFMatrix(values, depths=[-20.0, -10.0])
    other = PSFMatrix(values[1:, :, :, 1:-1, 2:-2], depths=[-10.0])
    both = pair(H, other)
    data = read_plane(H, both, 1)
    assert data.reference is not None and read_plane(H, both, 0).reference is None
    np.testing.assert_array_equal(data.reference.values[..., 1:-1, 2:-2], values[1, :, :, 1:-1, 2:-2])
    assert np.isnan(data.reference.values[..., 0, :]).all() and np.isfinite(data.levels["difference"]).all()
    apart = resolve(HIntent(z=1, view="difference"), data.plane, data.reference).linked
    assert np.nanmax(np.abs(apart)) < 1e-6


def test_intents_stay_inside() -> None:
    intent = HIntent(99, -3, 77, pixel=(7, 0)).clamped(SHAPE)
    assert (intent.z, intent.y, intent.x, intent.pixel) == (2, 0, 4, None)
    assert HIntent(0, 0, 0).moved(-1, -1, (4, 5)).y == 3
    assert turn_pixel((0, 0), (7, 9)) == (6, 8)


def test_places_and_planes_are_named_by_what_h_states() -> None:
    values = np.ones((2, 3, 3, 5, 5), np.float32)
    assert place_words(PSFMatrix(values), HIntent(z=1))[0] == "Plane 1 (0 to 1): depth\u00a0not\u00a0stated"
    known = place_words(PSFMatrix(values, depths=[-2000.0, -1000.0]), HIntent(z=1))
    assert known == ("Plane 1 (0 to 1): z\u00a0=\u00a0-1\u00a0mm", "Position y 0, x 0 of 3 × 3")
    # its focal length before the lens
    other = PSFMatrix(values, depths=(-260e3, 0.0), camera=preset("bench"))
    told = [place_words(other, HIntent(z=z))[0].replace("\u00a0", " ") for z in (0, 1)]
    assert told[0].endswith("z = -260 mm, where the camera of H sees nothing") and "v = " in told[1]
    assert aperture_tip(1, float("nan"), 2, None, None) == "Plane 1 (0 to 1)"
    assert format_plane(float("nan"), 1) == "plane 1" and format_plane(-1000.0, 1) == "-1 mm"
    refused = fitted(confident=False, refusal="cut off", kind="")
    tip = aperture_tip(1, -26_020.0, 2, refused, None)
    assert tip == f"Plane 1 (0 to 1): z = -26.02 mm\nfitted: {refused.describe()}"
    assert "reaches the edge" in refused.describe()


def fitted(**changes: Any) -> Aperture:
    known = {
        **{"kind": "polygon", "curvature": 0.12, "curvature_sigma": 0.03, "blur_px": 2.1, "confidence": 1.0},
        "confident": True,
    }
    return Aperture(7, (27.0, 26.5), 0.2, 15.27, 786.0, **(known | changes))


def test_fitted_numbers_of_an_aperture_are_next_to_the_expected_ones() -> None:
    expected = Aperture(7, (27, 27), 0.2, 15.63, 823.0, confident=True, kind="polygon")
    words = aperture_words(fitted(), expected, ())
    assert "expected" in words and "<b>15.27 px</b></td><td>15.63</td>" in words
    assert "<b>0.12 ± 0.03</b></td><td>0.00</td>" in words and "<b>2.10 px</b></td><td>—</td>" in words
    assert "expected" not in aperture_words(fitted())
    dark = aperture_words(fit_aperture(np.zeros((31, 31))), expected, ())
    assert "nan" not in dark and "0.00 px" not in dark and "0.0 %" not in dark, "of what is not seen"
    assert dark.count("<b>—</b>") >= 6
