"""Light fields, runs of a solver and views of a volume, without a window."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from lfcal.base import InputError, drain, format_bytes
from lfcal.camera import preset
from lfcal.cli._app import build_app
from lfcal.psf import PSFMatrix, save, voxel_um
from lfcal.reconstruct import MetricGrid, Projector, SolverChoice, reconstruct, resampling_for, run_memory, usual_margin
from lfcal.reconstruct.solvers.stopping import MOST_ITERATIONS
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.reconstruct.model import FIELDS, ReconstructSettings, used_by
from lfcal_gui.pages.reconstruct.model_solving import (
    Solving,
    light_field,
    make_light_field,
    outlook_of,
    projector_for,
    synthetic_shape,
)
from lfcal_gui.pages.reconstruct.model_volume import (
    MOST_ROWS,
    Prepared,
    Side,
    ViewCell,
    VolumeIntent,
    arrange,
    prepare,
    side,
)
from lfcal_gui.pages.reconstruct.step import step

PERIOD, CUTOUT = (3, 4), (7, 9)


def matrix_file(path: Path, planes: int = 2) -> str:
    """Write an H of blurred spots."""
    rng = np.random.default_rng(0)
    t, s = np.indices(CUTOUT)
    spot = np.exp(-((t - 3) ** 2 + (s - 4) ** 2) / 3.0)
    H = (spot * rng.uniform(0.5, 1, (planes, *PERIOD, *CUTOUT))).astype(np.float32)
    save(PSFMatrix(H), path)
    return str(path)


@pytest.fixture
def psf(tmp_path: Path) -> str:
    return matrix_file(tmp_path / "H.h5")


def opened(path: str) -> PSFMatrix:
    from lfcal.psf import open_psf

    return open_psf(path)


REFUSED: dict[str, tuple[object, ...]] = {
    **{"iterations": (0,), "threshold": (1.0, -0.1), "within": (1.0, -0.1), "margin": (-1,), "subsets": (0,)},
    **{"voxel": ("0", "-3", "inf", "small"), "background": (-1.0,), "read_noise": (float("nan"),), "anchor": ((1,),)},
    **{"region": ((0, 0, 0, 5), (1, 2), (0.5, 0, 3, 3)), "device": ("abacus",)},
}


def test_refusals_are_one_line() -> None:
    for key, values in REFUSED.items():
        for value in values:
            with pytest.raises(InputError) as error:
                ReconstructSettings().changed(key, value)
            assert "\n" not in str(error.value), (key, value)
    with pytest.raises(InputError, match="end: expected"):
        ReconstructSettings(stop="sometime")
    with pytest.raises(InputError, match="Gain: expected a number > 0"):
        ReconstructSettings(gain=0.0)


def test_fields_that_matter_and_settings_of_older_projects() -> None:
    assert used_by("rl-tv", "strength") and not used_by("rl", "strength")
    settings = ReconstructSettings("isra", read_noise=3.0, subsets=2)
    assert settings.choice() == SolverChoice("isra"), "greyed out: left alone"
    assert used_by("osem", "subsets") and not used_by("isra", "read_noise") and used_by("rl", "iterations")
    assert not ReconstructSettings(gain=2.0).choice().auto, "a gain that is left over is no reason to refuse"
    assert ReconstructSettings.from_dict({"auto": True, "iterations": 7}).stop == "left-out"
    assert ReconstructSettings.from_dict({"auto": False}).stop == ""
    assert {spec.key for spec in FIELDS} == {f.name for f in fields(ReconstructSettings)}
    tips = {field.key: field.tip for field in FIELDS}
    assert tips["strength"] == "Weight of the regularisation term (≥ 0). Empty: 0.002 for rl-tv, 0.02 for rl-tikhonov"
    assert not [tip for tip in tips.values() if "; empty" in tip or ".;" in tip or ". (" in tip]


def test_a_region_moves_the_anchor_with_it(psf: str) -> None:
    with opened(psf) as H:
        whole = projector_for([H], (24, 28), ReconstructSettings(margin=0))
        part = projector_for([H], (24, 28), ReconstructSettings(region=(5, 6, 14, 15), margin=0))
        volume = np.zeros(whole.volume_shape, np.float32)
        volume[1, 11, 13] = 1
        image = whole.forward(volume)
        np.testing.assert_allclose(part.forward(volume[:, 5:19, 6:21]), image[5:19, 6:21], atol=1e-6)
        wrong = projector_for([H], (14, 15), ReconstructSettings(margin=0))
        assert np.abs(wrong.forward(volume[:, 5:19, 6:21]) - image[5:19, 6:21]).max() > 0.01
        with pytest.raises(InputError, match="region"):
            projector_for([H], (20, 20), ReconstructSettings(region=(5, 6, 16, 15)))
        words = outlook_of(whole, SolverChoice(iterations=5)).words
        assert "28 × 24 × 2 voxels" in words and "5 iterations" in words


def test_files_voxels_and_tolerance_of_an_h_without_camera(psf: str, tmp_path: Path) -> None:
    with opened(psf) as H:
        P = projector_for([H], (24, 28), ReconstructSettings(within=0.01, method="direct"))
        assert P.tolerance == 0.01 and projector_for([H], (24, 28), ReconstructSettings()).tolerance == 0
        lean, accelerated = (run_memory(P, SolverChoice(name)) for name in ("rl", "rl-biggs"))
        assert accelerated.solver > 1.8 * lean.solver
        assert format_bytes(accelerated.solver) in outlook_of(P, SolverChoice("rl-biggs")).words
    with opened(psf) as H, pytest.raises(InputError, match="tif"):
        make_light_field(H, "points", str(tmp_path / "x.png"))
    assert not list(tmp_path.glob("x*"))
    with opened(psf) as H, pytest.raises(InputError, match="an H with its camera"):
        ReconstructSettings(voxel="auto").grid(H, (24, 25))


@pytest.mark.parametrize("name", ["points", "vesicle", "plume"])
def test_made_light_fields_follow_h(psf: str, tmp_path: Path, name: str) -> None:
    path = str(tmp_path / f"{name}.tif")
    with opened(psf) as H:
        made = make_light_field(H, name, path, shape=(24, 28))
        image = light_field(path)
        assert image.shape == (24, 28) and image.dtype == np.uint16
        model = projector_for([H], (24, 28), ReconstructSettings(margin=0)).forward(made.truth)
    sigma = (image - model) / np.sqrt(np.maximum(model, 1))
    assert np.abs(sigma).max() < 6, "photon noise alone is between them"
    assert model.max() == pytest.approx(2000, rel=1e-3)
    rows, columns = synthetic_shape(PSFMatrix(np.zeros((1, 200, 4, 9, 9), np.float32)))
    assert (rows, columns) == (640, 18)


def test_stopped_and_gone_on_is_the_same_as_at_once(psf: str, tmp_path: Path) -> None:
    with opened(psf) as H:
        made = make_light_field(H, "vesicle", str(tmp_path / "a.tif"), shape=(24, 28))
    image = light_field(made.path)
    settings = ReconstructSettings(iterations=6)
    at_once = Solving(psf, image, settings, made.truth)
    drain(at_once.work())
    halves = Solving(psf, image, settings)
    for record in halves.work():
        if halves.history and halves.history[-1].iteration == 2:
            halves.stop()
        assert record.done <= 24
    assert halves.state.iteration == 2
    drain(halves.work(4))
    assert at_once.state is not None
    np.testing.assert_allclose(halves.volume, at_once.volume, rtol=1e-6)
    assert [r.iteration for r in halves.history] == [1, 2, 3, 4, 5, 6]
    assert "NRMSE" in at_once.words() and "NRMSE" not in halves.words()
    assert halves.fits(psf, settings.changed("iterations", 99)) and not halves.fits(
        psf, settings.changed("solver", "isra")
    )
    assert at_once.details()["iterations"] == 6
    for one in (at_once, halves):
        one.close()
        one.close()


def test_cancelled_work_keeps_its_state(psf: str) -> None:
    solving = Solving(psf, np.ones((24, 28), np.uint16), ReconstructSettings(iterations=50, region=(2, 2, 20, 20)))
    work = solving.work()
    while not solving.history:
        next(work)
    work.close()
    assert solving.state is not None and solving.volume.shape == (2, 20, 20)
    assert solving.pixels == 400 and solving.truth is None
    solving.close()


def test_a_margin_takes_light_from_beside_the_region(psf: str) -> None:
    """The volume is that of the library with the same margin; where none is said, the one that helps."""
    image = np.random.default_rng(2).poisson(50, (24, 28)).astype(np.uint16)
    solving = Solving(psf, image, ReconstructSettings(iterations=3))
    drain(solving.work())
    with opened(psf) as H:
        margin = usual_margin(H.period, (H.shape[3], H.shape[4]), (24, 28))
        assert margin > 0 and solving.details()["margin"] == margin
        P = Projector(H, (24 + 2 * margin, 28 + 2 * margin), (H.anchor[0] + margin, H.anchor[1] + margin))
        wanted = reconstruct(P, image, SolverChoice(iterations=3, margin=margin)).volume
        words = outlook_of(P, SolverChoice(margin=margin)).words
        assert "28 × 24 × 2 voxels" in words and f"{margin} px around" in words
    assert solving.volume.shape == (2, 24, 28) == wanted.shape
    np.testing.assert_allclose(solving.volume, wanted, rtol=1e-5)
    solving.close()


@pytest.mark.parametrize(
    ("stop", "gain", "reason"), [("left-out", None, "held-out pixels"), ("discrepancy", 1.0, "noise")]
)
def test_a_run_that_stops_says_why(psf: str, tmp_path: Path, stop: str, gain: float | None, reason: str) -> None:
    with opened(psf) as H:
        made = make_light_field(H, "points", str(tmp_path / "a.tif"), shape=(48, 56), counts=30)
    solving = Solving(psf, light_field(made.path), ReconstructSettings("rl-biggs", iterations=2, stop=stop, gain=gain))
    drain(solving.work())
    assert 1 <= solving.state.iteration < MOST_ITERATIONS
    assert reason in solving.stopped and solving.stopped in solving.words()
    assert f"{solving.state.iteration} iterations" in solving.words()
    assert solving.details()["iterations"] == solving.state.iteration
    solving.close()


VOLUME = np.random.default_rng(1).random((3, 5, 7)).astype(np.float32)


def sides(intent: VolumeIntent, shown: Prepared) -> dict[str, Side]:
    """Return the three views with their usual axes."""
    axes = {"xy": "xy", "xz": "xz", "yz": "zy"}
    return {key: side(intent, shown, key, ViewCell(*both, (0, 0, 1, 1))) for key, both in axes.items()}


def test_volumes_of_hard_values_and_depths_have_pictures_of_bearable_size() -> None:
    assert prepare(VOLUME, None, None).squeeze == 1
    deep = prepare(VOLUME, np.array([0.0, 50.0, 100.0]), (1.0, 1.0))  # 150 deep, 7 wide: shorter by a round factor
    assert deep.squeeze == 0.05 and deep.lengths["z"] == pytest.approx(7.5)
    assert np.ptp(deep.axes["z"]) == pytest.approx(5)
    deepest = prepare(VOLUME, np.array([0.0, 1e5, 2e5]), (1.0, 1.0))
    assert sides(VolumeIntent(mode="Slices"), deepest)["xz"].values.shape[0] <= 1.6 * MOST_ROWS
    damaged = VOLUME.copy()
    damaged[0, 0, 0], damaged[2, 1, 1] = np.nan, 9.0
    shown = prepare(damaged, None, None)
    assert shown.brightest == (2, 1, 1) and shown.levels == (0.0, 9.0)
    for values in (np.zeros((3, 4, 5)), np.full((3, 4, 5), np.nan), np.full((1, 1, 6), 2.0), -np.ones((2, 2, 2))):
        shown = prepare(values.astype(np.float32), None, None)
        assert shown.levels[1] > shown.levels[0]
        assert all(0 not in side.values.shape for side in sides(VolumeIntent(mode="Projections"), shown).values())
    large = np.zeros((2, 301, 250))
    large[1, 222, 111] = 5
    tiled = prepare(large, None, None)
    assert tiled.tiles[1].max() == 5 and max(tiled.tiles[1].shape) <= 100 and tiled.shares.tolist() == [0, 1]
    assert np.isnan(tiled.depths).all(), "tiles keep the brightest voxel of each block"


ROOMS = ((620, 520), (306, 526), (520, 1030), (300, 200), (900, 300))


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 0.3), (1, 1, 0.02), (1, 1, 3.6), (1.6, 1, 2), (1, 3, 0.5)])
def test_three_views_use_the_room_at_one_scale(shape: tuple[float, ...]) -> None:
    lengths = dict(zip("xyz", (1000 * n for n in shape), strict=True))
    for room in ROOMS:
        cells, pixel = arrange(lengths, room, 3)
        used, taken = 0.0, np.zeros(room, int)
        for key, cell in cells.items():
            assert {cell.across, cell.down} == set(key)
            left, top, width, height = cell.rect
            across, down = lengths[cell.across] / pixel, lengths[cell.down] / pixel
            assert max(across - width, down - height) < 1e-6, "all of it is in view"
            taken[left : left + width, top : top + height] += 1
            used += across * down
        assert len(cells) == 3 and taken.max() == 1 and taken.mean() > 0.6, f"none covers another, {room}"
        if max(room) < 1.3 * min(room) and min(shape) > 0.5:
            assert used > 0.5 * np.prod(room)


def test_a_view_and_its_transposed_one_have_the_same_voxels() -> None:
    shown = prepare(VOLUME, None, None)
    for mode in ("Slices", "Projections"):
        intent = VolumeIntent(1, 2, 3, mode=mode)
        for key, found in sides(intent, shown).items():
            across, down = {"xy": "xy", "xz": "xz", "yz": "zy"}[key]
            other = side(intent, shown, key, ViewCell(down, across, (0, 0, 1, 1)))
            np.testing.assert_array_equal(other.values, found.values.T)
            assert other.origin == found.origin[::-1]


def test_slices_and_projections() -> None:
    intent, shown = VolumeIntent(1, 2, 3, mode="Slices"), prepare(VOLUME, None, None)
    found = sides(intent, shown)
    for key, wanted in (("xy", VOLUME[1]), ("xz", VOLUME[:, 2]), ("yz", VOLUME[:, :, 3].T)):
        np.testing.assert_array_equal(found[key].values, wanted)
        assert found[key].origin == (0, 0) and found[key].pixel == 1
    most = sides(VolumeIntent(mode="Projections"), shown)
    for key, wanted in (("xy", VOLUME.max(0)), ("xz", VOLUME.max(1)), ("yz", VOLUME.max(2).T)):
        np.testing.assert_array_equal(most[key].values, wanted)
    assert shown.levels == (0.0, VOLUME.max()) and VOLUME[shown.brightest] == VOLUME.max()
    assert VolumeIntent(9, -1, 99).clamped(VOLUME.shape) == VolumeIntent(2, 0, 6)


@pytest.mark.parametrize("depths", [(-40.0, -20.0, 20.0), (20.0, -20.0, -40.0)])
def test_from_the_side_planes_are_as_far_apart_as_they_are(depths: tuple[float, ...]) -> None:
    """Each pixel is of the nearest plane, near ones at the top, whichever plane comes first in the volume."""
    shown = prepare(VOLUME, np.array(depths), (5.0, 10.0))
    side = sides(VolumeIntent(1, 2, 3, mode="Slices"), shown)["xz"]
    rows, columns = side.values.shape
    assert side.pixel == 5 and columns == 14, "a voxel is two pixels wide"
    at = side.origin[0] + 5 * np.arange(rows)
    assert at[0] < -45 and at[-1] > 35, "half a step beyond the outer planes"
    for z, row in zip(at, side.values, strict=True):
        distance = np.abs(np.array(depths) - z)
        assert any(np.array_equal(row[::2], VOLUME[k, 2]) for k in np.flatnonzero(distance < distance.min() + 1e-6))


def test_a_volume_is_saved_with_voxels_of_one_size(tmp_path: Path) -> None:
    """As ``lfcal reconstruct --voxel`` writes it; the size may be chosen when all is done."""
    camera, depths = preset("bench"), (-26_000.0, -20_000.0)
    values = np.random.default_rng(0).random((2, 3, 4, 5, 5)).astype(np.float32)
    save(PSFMatrix(values, depths=depths, camera=camera), tmp_path / "H.h5")
    image = np.random.default_rng(1).uniform(50, 100, (24, 26)).astype(np.float32)
    solving = Solving(str(tmp_path / "H.h5"), image, ReconstructSettings(iterations=2, region=(2, 3, 18, 20)))
    drain(solving.work())
    plain = solving.placed(solving.settings)
    assert plain.volume.shape == (2, 18, 20) and plain.voxel_um == solving.voxel_um
    one = replace(solving.settings, voxel="auto")
    assert solving.fits(solving.psf, one), "and one can go on"
    placed = solving.placed(one)
    with opened(solving.psf) as H:
        row, column = H.anchor
        grid = MetricGrid.for_matrix(H, (18, 20), (row - 2, column - 3))
        sides = [voxel_um(H, depth) for depth in depths]
    np.testing.assert_array_equal(placed.volume, grid.apply(solving.volume))
    assert placed.voxel_um == (min(sides)[0],) * 2 and placed.details["origin_um"] == grid.origin_um
    np.testing.assert_allclose(placed.volume.sum((1, 2)), solving.volume.sum((1, 2)), rtol=1e-5)
    assert solving.placed(replace(one, voxel="50")).voxel_um == (50.0, 50.0)
    solving.close()


@pytest.mark.parametrize("as_is", [False, True])
def test_a_drifting_lattice_is_resampled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_is: bool) -> None:
    """As the command does it; the window used every light field as it is, without a word."""
    monkeypatch.chdir(tmp_path)
    camera = preset("lfm_60x12")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(130, 136)))
    rng = np.random.default_rng(0)
    H = PSFMatrix(rng.random((1, 15, 15, 5, 5)).astype(np.float32), depths=[1.0], camera=camera, anchor=(60.0, 63.0))
    save(H, "H.h5")
    image = rng.poisson(80, camera.sensor.shape).astype(np.uint16)
    tifffile.imwrite("frame.tif", image)
    settings = ReconstructSettings("rl", iterations=2, as_is=as_is, voxel="2.5")
    solving = Solving("H.h5", image, settings)
    drain(solving.work())
    assert solving.volume.shape == ((1, 130, 136) if as_is else (1, *resampling_for(H, (130, 136)).shape))
    assert ("warning: " if as_is else "") + "the lattice drifts by 3.46 px over the frame" in solving.words()
    project = ProjectState(psf="H.h5", light_field="frame.tif")
    done = step(replace(project, settings=settings.into(project)), "v.tif")
    assert ("--resample=never" in done.arguments) == as_is
    assert CliRunner().invoke(build_app(), list(done.arguments)).exit_code == 0
    exec(compile(done.script().replace("v.tif", "w.tif"), "script", "exec"), {})
    expected = solving.placed(settings).volume
    for out in ("v.tif", "w.tif"):
        found = tifffile.imread(out)
        np.testing.assert_allclose(found.reshape(expected.shape), expected, rtol=1e-4, atol=1e-4 * expected.max())
    solving.close()
