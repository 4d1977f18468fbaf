"""Points and curves: the front, the cheapest point, words, and pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import matplotlib.axes
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfcal.accuracy import CostPoint, Curve, draw_curves, marked, marks_of
from lfcal.base import InputError

PAIRS = st.lists(st.tuples(st.floats(0, 1e3), st.floats(0, 10)), min_size=1, max_size=30)


def point(cost: float, error: float, label: str = "") -> CostPoint:
    return CostPoint(label or f"{cost} {error}", {"tolerance": error}, error, cost, "seconds")


def curve(*pairs: tuple[float, float]) -> Curve:
    made = Curve("storage", "Storage", "relative L1 error", "seconds", "seconds", "the values", notes=("a note",))
    for cost, error in pairs:
        made = made.with_point(point(cost, error))
    return made


@given(PAIRS)
def test_the_front_is_what_nothing_beats(pairs: list[tuple[float, float]]) -> None:
    points = marked(point(*pair) for pair in pairs)
    assert sorted((r.cost, r.error) for r in points) == sorted(pairs)
    front = [(r.cost, r.error) for r in points if r.efficient]
    # by the definition, pair by pair: nothing is at least as good in both and better in one
    beaten = {(c, e) for c, e in pairs if any((a <= c and b < e) or (a < c and b <= e) for a, b in pairs)}
    assert front == sorted(set(pairs) - beaten)
    costs, errors = zip(*front, strict=True)
    assert (np.diff(costs) > 0).all() and (np.diff(errors) < 0).all()


@given(PAIRS, st.floats(1e-6, 10))
def test_the_cheapest_point_keeps_the_error(pairs: list[tuple[float, float]], error: float) -> None:
    found = curve(*pairs).cheapest(error)
    good = [c for c, e in pairs if e <= error]
    assert (found is None) == (not good)
    if found is not None:
        assert found.error <= error and found.cost == min(good)


def test_what_one_per_cent_would_cost() -> None:
    made = curve((1.0, 0.3), (60.0, 0.009), (7200.0, 0.001))
    assert made.answer(0.01) == "An error of 1 % costs 1 min 00 s: 60.0 0.009 (0.9 %)"
    reached = "No measured setting reaches an error of 0.01 %; the best one has 0.1 % for 2 h 00 min: 7200.0 0.001"
    assert made.answer(1e-4) == reached
    assert curve().answer(0.01) == "Error of 1 %: nothing was measured"
    with pytest.raises(InputError, match="requested error"):
        made.cheapest(0)


def test_errors_and_costs_are_finite_and_not_negative() -> None:
    for value in (float("nan"), float("inf"), -1.0):
        for pair in ((1.0, value), (value, 1.0)):
            with pytest.raises(InputError):
                point(*pair)
    with pytest.raises(InputError, match="unit of cost"):
        CostPoint("a", {}, 1.0, 1.0, "apples")


def test_points_are_marked_as_chosen_in_use_and_efficient() -> None:
    made = curve((1.0, 0.3), (2.0, 0.4), (60.0, 0.009))
    made = made.with_point(replace(point(3.0, 0.02), in_use=True))
    marks = [marks_of(one, made.cheapest(0.05)) for one in made.points]
    assert marks == [("efficient",), (), ("chosen", "in use", "efficient"), ("efficient",)]
    assert made.in_use == made.points[2] and curve((1.0, 0.3)).in_use is None


def test_the_chosen_point_and_the_one_in_use_are_named_where_there_is_no_room(tmp_path, monkeypatch):
    # 40 points at almost the same position have room for a few names only
    made = curve(*((1.0 + 1e-6 * k, 0.5 - 1e-6 * k) for k in range(40)))
    chosen = made.points[20]
    made = made.with_point(replace(point(1.0 + 3e-5, 0.6, "mine"), in_use=True))
    shown: list[str] = []

    def kept(axes: matplotlib.axes.Axes, *_: object) -> None:
        shown.extend(text.get_text() for text in axes.texts)

    monkeypatch.setattr("lfcal.accuracy.drawing.save_figure", lambda fig, path: kept(fig.axes[0]))
    draw_curves([made], tmp_path / "a.png", error=chosen.error)
    assert f"{chosen.label} (chosen)" in shown and "mine (in use)" in shown and len(shown) < 20


def test_a_page_has_a_panel_for_each_curve_with_points(tmp_path: Path) -> None:
    # an error of zero has no logarithm, and is drawn all the same
    shown = curve((1.0, 0.3), (60.0, 0.0))
    draw_curves([shown, curve()], tmp_path / "one.png", "title", error=0.01)
    draw_curves([shown] * 4, tmp_path / "four.png")
    one, four = (cv2.imread(str(tmp_path / name)).shape for name in ("one.png", "four.png"))
    assert four[0] == 2 * one[0] and four[1] == 3 * one[1]
    with pytest.raises(InputError, match="curves to draw"):
        draw_curves([curve()], tmp_path / "none.png")
