"""Fits of a camera over months: real changes are distinguished from noise."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import Camera
from lfcal.judge.dated import fits_in, read_dated_fit
from lfcal.judge.trend import draw_trend, trend
from tests.fit.common import small_camera

START = datetime(2026, 1, 1, tzinfo=UTC)
SIGMA = {"gap_um": 0.1, "rotation_rad": 1e-4, "offset_y_um": 0.02, "offset_x_um": 0.02, "f_number": 0.004}
GROUP = {"f_number": "iris"}


def write_fit(
    place: Path, day: float, values: dict[str, float] | None = None, camera: Camera | None = None, **more: Any
) -> Path:
    """Write what a fit's folder holds of a camera, ``values`` found otherwise, at noon of a day."""
    camera = camera or small_camera()
    found = {"gap_um": camera.lattice.gap_um, "rotation_rad": 0.0, "offset_y_um": 0.0, "offset_x_um": 0.0}
    found |= {"f_number": 4.0} | (values or {})
    rows = [
        {"name": name, "group": GROUP.get(name, "geometry"), "unit": "µm", "value": v, "sigma": SIGMA.get(name, 1.0)}
        for name, v in found.items()
    ]
    data = {
        "format": "lfcal-fit",
        "version": 1,
        "camera": camera.name,
        "complete": True,
        "groups": sorted({one["group"] for one in rows}),
        "parameters": rows,
        "depths_um": [300.0],
        "middle_um": [10.0, -20.0],
        "recorded": (START + timedelta(days=day)).isoformat(),
    } | more
    place.mkdir(parents=True)
    (place / "fit.json").write_text(json.dumps({k: v for k, v in data.items() if v is not None}))
    (place / "camera.json").write_text(camera.to_json())
    return place


def months(place: Path, count: int = 6, drift: float = 0.0, jump: float = 0.0, seed: int = 0) -> list[Path]:
    """Write monthly fits with noise of their sigmas: a gap that drifts by so much a month, and jumps in the middle."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        gap = 400.0 + drift * k + jump * (k >= count // 2)
        values = {"gap_um": gap, "f_number": 4.0}
        noisy = {name: v + SIGMA[name] * float(rng.standard_normal()) for name, v in values.items()}
        made.append(write_fit(place / f"fit{k}", k * 365.25 / 12, noisy))
    return made


def trend_of(*folders: Path, **more: float) -> Any:
    return trend([read_dated_fit(one) for one in folders], **more)


def by_name(found: Any) -> dict[str, Any]:
    return {one.name: one for one in found.courses}


def test_noise_is_no_trend(tmp_path: Path) -> None:
    for seed in range(8):
        found = trend_of(*months(tmp_path / str(seed), seed=seed))
        assert not found.worse and not found.notes
        gap = by_name(found)["gap_um"]
        # the slope of six monthly values: sigma / sqrt(sum of squared months from their mean)
        assert gap.per_month_sigma >= 0.1 / math.sqrt(17.5) * 0.999 and abs(gap.per_month) < 5 * gap.per_month_sigma


def test_a_drift_is_found_with_its_rate(tmp_path: Path) -> None:
    found = trend_of(*reversed(months(tmp_path, drift=0.25)))
    gap, aperture = by_name(found)["gap_um"], by_name(found)["f_number"]
    assert gap.worse and not aperture.worse and [one.name for one in found.worse] == ["gap_um"]
    assert abs(gap.per_month - 0.25) < 4 * gap.per_month_sigma < 0.15
    assert [one.label for one in found.sessions] == [f"fit{k}" for k in range(6)], "by their dates"
    # no step of it is more than noise
    assert not gap.jumps and abs(gap.change_sigmas) > 5


def test_fits_of_one_day_have_a_change_and_no_rate(tmp_path: Path) -> None:
    """An hour apart, a tenth of a micrometre would be 70 of them a month."""
    for days, known in ((1 / 24, False), (6.9, False), (7.0, True)):
        place = tmp_path / str(days)
        paths = [write_fit(place / name, day, {"gap_um": gap}) for name, day, gap in (("a", 0, 400), ("b", days, 402))]
        found = trend_of(*paths)
        gap = by_name(found)["gap_um"]
        assert gap.worse and gap.change == pytest.approx(2.0) and gap.span_s == pytest.approx(days * 86400)
        assert math.isfinite(gap.per_month) is known and math.isfinite(gap.per_month_sigma) is known
        assert any("a change per month is not estimated" in note for note in found.notes) is not known


def test_a_moved_source_is_named_as_another_cause_of_a_changed_gap(tmp_path: Path) -> None:
    words = "the distance was fixed in these fits"
    fits = [read_dated_fit(path) for path in months(tmp_path / "a", drift=0.5)]
    assert any(note.startswith(words) for note in trend(fits).notes)
    found = [replace(one, groups=one.groups | {"distance"}) for one in fits]
    assert not any(note.startswith(words) for note in trend(found).notes)
    still = [read_dated_fit(path) for path in months(tmp_path / "b")]
    assert not any(note.startswith(words) for note in trend(still).notes)


def test_a_jump_is_found_where_it_was(tmp_path: Path) -> None:
    fits = months(tmp_path, jump=1.5)
    gap = by_name(trend_of(*fits))["gap_um"]
    assert gap.worse and [(one.before, one.after) for one in gap.jumps] == [("fit2", "fit3")]
    assert abs(gap.jumps[0].change - 1.5) < 4 * math.sqrt(2) * 0.1
    assert abs(gap.jumps[0].sigmas - gap.jumps[0].change / (math.sqrt(2) * 0.1)) < 1e-9
    assert not trend_of(*fits, sigmas=30.0).worse


def test_offsets_are_places_of_the_array_whatever_each_fit_started_from(tmp_path: Path) -> None:
    """A fit that starts from the camera of the one before finds 0 where that one found 0.4."""
    camera = small_camera()
    moved = replace(camera, lattice=replace(camera.lattice, offset_um=(camera.lattice.offset_um[0] + 0.4, 0.0)))
    same = [
        write_fit(tmp_path / "a", 0, {"offset_x_um": 0.4}, moved),
        write_fit(tmp_path / "b", 30, {"offset_x_um": 0.0}, moved),
    ]
    assert by_name(trend_of(*same))["offset_x_um"].change == pytest.approx(0.0, abs=1e-9)
    # and one that finds 0 from another description has moved
    back = write_fit(tmp_path / "c", 60, {"offset_x_um": 0.0}, camera)
    found = by_name(trend_of(*same, back))
    assert found["offset_x_um"].change == pytest.approx(-0.4) and found["offset_x_um"].worse
    assert not found["offset_y_um"].worse
    # an array displaced by a whole period of its types is where it was
    step = camera.lattice.basis_um()[0]
    whole = replace(moved, lattice=replace(moved.lattice, offset_um=tuple(np.array(moved.lattice.offset_um) + step)))
    again = write_fit(tmp_path / "d", 90, {}, whole)
    change = by_name(trend_of(same[0], again))["offset_x_um"].change
    assert change == pytest.approx(0.0, abs=1e-9)


def test_parameters_of_other_models_are_not_compared(tmp_path: Path) -> None:
    """A gap fitted together with an aberration is another number than one fitted without."""
    first = write_fit(tmp_path / "a", 0, {"gap_um": 402.0}, groups=["geometry", "iris", "spherical"])
    rest = [write_fit(tmp_path / name, day, {"gap_um": 400.0}) for name, day in (("b", 30), ("c", 60))]
    found = trend_of(first, *rest)
    gap = by_name(found)["gap_um"]
    assert not found.worse and [point.compared for point in gap.points if point] == [False, True, True]
    assert any(note.startswith("a: not compared, because their unknowns") for note in found.notes)
    deeper = write_fit(tmp_path / "d", 90, {"distance_um": 50.0}, depths_um=[500.0])
    other = write_fit(tmp_path / "e", 120, {"distance_um": 0.0}, depths_um=[300.0])
    distance = json.loads((deeper / "fit.json").read_text())
    for one in distance["parameters"]:
        one["group"] = "distance" if one["name"] == "distance_um" else one["group"]
    for folder in (deeper, other):
        data = json.loads((folder / "fit.json").read_text()) | {"parameters": distance["parameters"]}
        (folder / "fit.json").write_text(json.dumps(data))
    assert not by_name(trend_of(deeper, other))["distance_um"].points[0].compared


def test_poor_fits_and_missing_dates_are_noted(tmp_path: Path) -> None:
    one = write_fit(tmp_path / "a", 0, complete=False)
    two = write_fit(tmp_path / "b", 0, recorded=None, fitted="2026-03-01T00:00:00+00:00")
    three = write_fit(tmp_path / "c", 0, recorded=None)
    notes = " ".join(trend_of(one, two, three).notes)
    assert "a: the model was incomplete" in notes and "b: dated by the fit" in notes and "c: no date" in notes


def test_fits_of_several_cameras_or_one_fit_alone_are_refused(tmp_path: Path) -> None:
    one, two = write_fit(tmp_path / "a", 0), write_fit(tmp_path / "b", 30, camera=small_camera("r29"))
    for folders, more, words in (
        ((one, two), {}, "of one camera"),
        ((one,), {}, "at least two"),
        ((one, one), {}, "fits with different times"),
        ((one, one), {"sigmas": 0.0}, r"threshold of an alarm \(standard deviations\)"),
    ):
        with pytest.raises(InputError, match=words):
            trend_of(*folders, **more)


def test_other_and_damaged_files_are_refused(tmp_path: Path) -> None:
    folder = write_fit(tmp_path / "fit", 0)
    path, whole = folder / "fit.json", (folder / "fit.json").read_text()
    listed = '{"format": "lfcal-fit", "parameters": [1], "groups": []}'
    for text in ("", "[]", "{}", '{"format": "lfcal-fit"}', listed, "\0"):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=r"fit\.json"):
            read_dated_fit(folder)
    for name, value in (("value", None), ("sigma", "x"), ("value", True), ("recorded", "yesterday")):
        data = json.loads(whole)
        (data if name == "recorded" else data["parameters"][0])[name] = value
        path.write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match="damaged"):
            read_dated_fit(folder)


def test_folders_of_fits_are_found(tmp_path: Path) -> None:
    made = months(tmp_path / "all", 3)
    assert fits_in(tmp_path / "all") == made and fits_in(made[0]) == fits_in(made[0] / "fit.json") == [made[0]]
    for place, what in ((tmp_path / "no", "no such folder"), (tmp_path, "none")):
        with pytest.raises(InputError, match=what):
            fits_in(place)


def test_the_picture_shows_every_parameter(tmp_path: Path) -> None:
    found = trend_of(*months(tmp_path, 3, jump=3.0))
    draw_trend(found, tmp_path / "trend.svg")
    text = (tmp_path / "trend.svg").read_text()
    assert text.count('<g id="axes_') == 6 and len(found.courses) == 5, "one panel stays empty"


def test_a_coarser_pitch_moves_no_lenslet_that_it_leaves_in_place(tmp_path: Path) -> None:
    """The lenslet that is compared is the one nearest the middle, not its neighbour."""
    camera = small_camera()
    lattice = camera.lattice
    middle = lattice.centres_um(np.array(0.9), np.array(0.9))
    coarser = replace(lattice, pitch_um=1.01 * lattice.pitch_um)
    shift = lattice.centres_um(np.array(1.0), np.array(1.0)) - coarser.centres_um(np.array(1.0), np.array(1.0))
    coarser = replace(coarser, offset_um=tuple((np.array(coarser.offset_um) + shift).tolist()))
    fits = [
        read_dated_fit(
            write_fit(tmp_path / str(k), 30.0 * k, {}, replace(camera, lattice=one), middle_um=middle.tolist())
        )
        for k, one in enumerate((coarser, lattice))
    ]
    found = by_name(trend(fits))
    assert [found[name].change for name in ("offset_y_um", "offset_x_um")] == pytest.approx([0.0, 0.0], abs=1e-9)
