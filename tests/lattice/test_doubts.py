from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.lattice._doubts import Evenness, check_white, evenness
from lfcal.lattice.fit import fit_lattice
from tests.lattice.white_frames import draw_white

REAL = Path(__file__).parents[3] / "shared/data/lfm_guv"
SHAPE = (300, 380)


@pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not on this machine")
@pytest.mark.parametrize("dark", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_real_specimen_is_refused_and_the_real_white_image_is_not_doubted(dark: bool) -> None:
    from lfcal.frames import read_image

    level: Any = read_image(REAL / "DarkFrame_GUVExperim1.tif") if dark else 0.0
    with pytest.raises(InputError, match="specimen"):
        fit_lattice(read_image(REAL / "Lightfield_GUVExperim1.tif"), dark=level)
    assert fit_lattice(read_image(REAL / "Radiometry_GUVExperim1.tif"), dark=level).notes == ()


WHITE: dict[str, dict[str, Any]] = {
    "brightness scatters by 15 %": {"scatter": 0.15},
    "three types": {"pitch": 22.3, "edges": (0.7, 2.0, 3.3)},
    "noise": {"snr": 3.0},
    "cores saturated": {"full": 0.6},
    "gradient": {"light": lambda x, y: 1 + 0.7 * x},
    "falls to a fifth": {"falloff": 0.8},
    "half lit": {"light": lambda x, y: (x > 0.02).astype(float)},
}


@pytest.mark.few(1)
@pytest.mark.parametrize("name", WHITE)
def test_white_images_of_all_sorts_are_not_doubted(name: str) -> None:
    truth = draw_white(SHAPE, dark=0.0, **WHITE[name])
    fit = fit_lattice(truth.frame)
    assert [note for note in fit.notes if "extrapolated elsewhere" not in note] == []
    assert fit.pitch_px == pytest.approx(truth.pitch, abs=0.01)


def fermi(distance: Any, width: float) -> Any:
    return 1 / (1 + np.exp(np.clip(distance / width, -50, 50)))


@pytest.mark.parametrize(
    ("light", "seed"),
    [
        (lambda x, y: fermi(np.hypot(x, y) - 0.8, 0.05), 4),
        (lambda x, y: fermi(-x - 0.2, 0.08), 6),
        (lambda x, y: np.exp(-2 * (x * x + y * y)), 4),
    ],
    ids=["soft disc", "soft edge", "bell"],
)
@pytest.mark.few(1)
def test_the_rim_of_the_light_bends_no_straight_lattice(light: Any, seed: int) -> None:
    truth = draw_white(SHAPE, dark=0.0, light=light, seed=seed)
    fit = fit_lattice(truth.frame)
    assert fit.form == "affine"
    q, r = fit.index[~fit.dead].T
    assert np.hypot(*truth.errors(fit.centres_px(q, r)).T).max() < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize(("kind", "seed"), [("hexagonal", 0), ("hexagonal", 2), ("square", 0), ("square", 4)])
def test_a_beam_s_bell_draws_no_lenslet_to_its_middle(kind: str, seed: int) -> None:
    """Light that falls to two percent in the corners: a polynomial of it would fall too fast or too slowly there."""
    truth = draw_white(SHAPE, kind=kind, dark=0.0, light=lambda x, y: np.exp(-2 * (x * x + y * y)), seed=seed)
    fit = fit_lattice(truth.frame)
    assert fit.form == "affine"
    q, r = fit.index[~fit.dead].T
    assert np.hypot(*truth.errors(fit.centres_px(q, r)).T).max() < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", [0, 3])
def test_a_square_lattice_lit_by_half_is_found(seed: int) -> None:
    """No places hold a flexible lattice in the dark half: a bend that turns back there is none."""
    truth = draw_white(SHAPE, kind="square", dark=0.0, light=lambda x, y: (x > 0.02).astype(float), seed=seed)
    fit = fit_lattice(truth.frame)
    assert fit.form == "affine"
    q, r = fit.index[~fit.dead].T
    assert np.hypot(*truth.errors(fit.centres_px(q, r)).T).max() < 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("size", [8.0, 30.0])
def test_drawn_specimens_are_refused(size: float) -> None:
    import cv2

    white = draw_white(SHAPE, dead=0.0, dark=0.0).frame
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(size=SHAPE), (0, 0), size)
    with pytest.raises(InputError, match="specimen") as caught:
        fit_lattice(white * np.exp(0.4 * grain / grain.std()))
    assert "\n" not in str(caught.value)


def test_cells_of_a_tissue_are_doubted() -> None:
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(2)
    cells = np.array([((i + 0.5 * (j % 2)) * 16, j * 13.9) for i in range(-2, 28) for j in range(-2, 26)])
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    near, _ = cKDTree(cells + rng.normal(0, 0.8, cells.shape)).query(np.stack([x, y], -1).reshape(-1, 2), k=2)
    wall = np.clip((near[:, 1] - near[:, 0]).reshape(SHAPE) / 5, 0, 1)
    notes = fit_lattice(1000 * wall + rng.normal(0, 20, SHAPE)).notes
    assert any("more than noise explains" in note for note in notes)


def test_evenness_by_hand() -> None:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(20), np.arange(16)))
    index, places = np.stack([q, r], -1), 10.0 * np.stack([r, q], -1)
    alive = np.ones(len(q), bool)
    alternating = 100.0 * (1 + 0.2 * (-1.0) ** (q + r))
    found = evenness(index, alternating, alive, places)
    assert found.shared == 0.0 and found.scatter > 0.1
    blocks = 100.0 * (1 + 0.3 * (-1.0) ** (q // 2 + r // 2))
    assert evenness(index, blocks, alive, places).shared > 0.1
    even = evenness(index, np.full(len(q), 100.0), alive, places)
    assert max(even.shared, even.scatter) < 1e-6


def test_each_doubt_is_one_line() -> None:
    assert check_white(Evenness(0.01, 0.05), 0.03, 0.2, 15.0) == ()
    notes = check_white(Evenness(0.06, 0.25), 0.6, 0.2, 15.0)
    assert len(notes) == 3 and all("\n" not in note for note in notes)
