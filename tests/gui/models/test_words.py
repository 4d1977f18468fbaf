from __future__ import annotations

from gui.models.words import plane_words


def test_planes_count_from_zero() -> None:
    assert plane_words(1, 2) == "Plane 1 (0 to 1)" and plane_words(0, 1) == "Plane 0 (the only one)"
