from __future__ import annotations

from lfcal_gui.models.words import minus, plane_words, rough_seconds, typeset, unbroken


def test_planes_count_from_zero() -> None:
    assert plane_words(1, 2) == "Plane 1 (0 to 1)" and plane_words(0, 1) == "Plane 0 (the only one)"


def test_words_of_the_library_are_typeset() -> None:
    assert typeset("hollow sphere of 2x128x128 voxels, 20000 e-") == "hollow sphere of 2 × 128 × 128 voxels, 20000 e⁻"
    assert typeset("19 x 33; pixel `anchor`; lens_types, e-6") == "19 × 33; pixel anchor; lens types, e-6"
    assert typeset("position x 9 of 1e-5") == "position x 9 of 1e-5"


def test_no_line_ends_between_a_number_and_its_unit() -> None:
    assert unbroken("polyphase 54.5 ms a pair, 2 of 3") == "polyphase 54.5\u00a0ms a pair, 2\u00a0of 3"
    assert unbroken("in about 4 min 19 s for 95 × 55") == "in about 4\u00a0min\u00a019\u00a0s for 95\u00a0×\u00a055"
    assert unbroken("good; ≤ 0.35 px, > 1 bad") == "good; ≤\u00a00.35\u00a0px, >\u00a01\u00a0bad"


def test_a_forecast_has_no_more_digits_than_it_is_good_for() -> None:
    assert rough_seconds(0.33) == "less than 1 s" and rough_seconds(3.2) == "about 3 s"
    assert rough_seconds(259) == "about 4 min 19 s" and rough_seconds(9.6, "") == "10 s"


def test_negative_numbers_have_a_minus_sign_and_names_keep_their_hyphens() -> None:
    assert minus("-20.03 mm to -.5, (-1, -2)") == "−20.03 mm to −.5, (−1, −2)"
    assert minus("2026-03-16, type-0, H-1.h5, 3-5, 1e-06, --z -0") == "2026-03-16, type-0, H-1.h5, 3-5, 1e-06, --z −0"
    assert minus("<p style='margin:-4'>-4</p>") == "<p style='margin:-4'>−4</p>"
