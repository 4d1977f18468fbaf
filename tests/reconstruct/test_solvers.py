from __future__ import annotations

import ast
import inspect
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.reconstruct import Projector
from lfcal.reconstruct.phantoms import nrmse, phantom
from lfcal.reconstruct.solvers._em import EmOptions, EmUpdates, IsraSettings, RichardsonLucySettings
from lfcal.reconstruct.solvers._subsets import angular_subsets, by_energy, interleaved_subsets
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, reconstruct
from lfcal.reconstruct.solvers.image_space import isra, iter_isra
from lfcal.reconstruct.solvers.least_squares import LeastSquaresSettings, conjugate_gradient, iter_conjugate_gradient
from lfcal.reconstruct.solvers.measurement import NothingMeasured
from lfcal.reconstruct.solvers.multiplicative import iter_richardson_lucy, richardson_lucy
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.solver import SolverRun, SolverSettings
from tests.reconstruct.oracles import dense, lenslet_psf


@pytest.fixture(scope="module")
def scene():
    """Return a projector, a true volume and its noisy image on a background of 2."""
    P = Projector(lenslet_psf(), (60, 55), (1, 3))
    truth = phantom("vesicle", P.volume_shape) * 200
    image = np.random.default_rng(0).poisson(np.maximum(P.forward(truth), 0) + 2).astype(float)
    return P, truth, image


def tiny(seed=0):
    """Return projector, dense matrix, image and background of a problem small enough for plain algebra."""
    rng = np.random.default_rng(seed)
    H = rng.random((2, 3, 2, 5, 5))
    P = Projector(H, (9, 8), (1, 0), dtype=np.float64)
    return P, dense(H, (9, 8), (1, 0)), rng.uniform(1, 20, (9, 8)), 0.7


def test_richardson_lucy_is_equation_2():
    P, A, f, b = tiny()
    g = np.full(A.shape[1], max((f - b).sum(), 0) / A.sum())
    for _ in range(7):
        g = g / (A.T @ np.ones(len(A))) * (A.T @ (f.ravel() / (A @ g + b)))
    result = richardson_lucy(P, f, 7, background=b)
    assert np.allclose(result.volume.ravel(), g, rtol=1e-10)
    wrong = richardson_lucy(P, f, 7, background=0.0)  # leaving the background out is another equation
    assert not np.allclose(wrong.volume.ravel(), g, rtol=1e-3)


def test_weights_leave_pixels_out_entirely():
    P, A, f, b = tiny()
    w = (np.random.default_rng(1).random(f.shape) < 0.7).astype(float)
    rows = w.ravel() > 0
    g = np.full(A.shape[1], (w * (f - b)).sum() / A[rows].sum())
    for _ in range(5):
        g = g / A[rows].sum(0) * (A[rows].T @ (f.ravel()[rows] / (A[rows] @ g + b)))
    spoilt = f.copy()
    spoilt[w == 0] = 1e9
    assert np.allclose(richardson_lucy(P, spoilt, 5, background=b, weights=w).volume.ravel(), g, rtol=1e-10)


def test_isra_and_conjugate_gradients_minimise_squares():
    P, A, f, b = tiny()
    g = np.full(A.shape[1], (f - b).sum() / A.sum())
    for _ in range(6):
        g *= (A.T @ f.ravel()) / (A.T @ (A @ g + b))
    assert np.allclose(isra(P, f, 6, background=b).volume.ravel(), g, rtol=1e-10)
    damping = 1e-3
    weak = damping * np.abs(A.T @ (A @ np.ones(A.shape[1]))).max()
    exact = np.linalg.solve(A.T @ A + weak * np.eye(A.shape[1]), A.T @ (f.ravel() - b))
    found = conjugate_gradient(P, f, 200, background=b, damping=damping)
    assert np.allclose(found.volume.ravel(), exact, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("penalty", [TotalVariation(0.2), Tikhonov(0.6)])
def test_a_steep_penalty_lets_no_voxel_grow_more_than_tenfold(penalty):
    """One step late by plain algebra; where the gradient eats the sensitivity up, a tenth of it is left."""
    P, A, f, b = tiny()
    start = np.random.default_rng(5).uniform(0.1, 5, P.volume_shape)
    sensitivity = A.T @ np.ones(len(A))
    lowered = sensitivity + sensitivity.max() * penalty.gradient(start).ravel()
    assert (lowered < 0).sum() > 5 and ((lowered > 0) & (lowered < 0.1 * sensitivity)).any(), "the case is a hard one"
    g = start.ravel()
    back = A.T @ (f.ravel() / (A @ g + b))
    expected = g * back / np.maximum(lowered, 0.1 * sensitivity)
    found = richardson_lucy(P, f, 1, background=b, penalty=penalty, initial=start).volume.ravel()
    assert np.allclose(found, expected, rtol=1e-10)
    assert (found <= 10.001 * g * back / sensitivity).all() and (found >= 0).all()


def test_likelihood_of_a_record_is_that_of_its_start():
    P, A, f, b = tiny()
    result = richardson_lucy(P, f, 3, background=b)
    m = A @ richardson_lucy(P, f, 2, background=b).volume.ravel() + b
    d = f.ravel()
    assert np.isclose(result.history[2].likelihood, -(d * np.log(d / m) - d + m).sum())
    assert np.isclose(result.history[2].residual, np.linalg.norm(d - m) / np.linalg.norm(d))


def test_names_that_files_and_scripts_keep():
    kept = ("rl", "rl-tv", "rl-tikhonov", "rl-biggs", "rl-nesterov", "osem", "phase-space")
    assert SOLVERS.names() == (*kept, "sieve", "isra")


@pytest.mark.parametrize("name", SOLVERS.names())
def test_every_solver_improves_and_reports(scene, name):
    P, truth, image = scene
    result = reconstruct(P, image, SolverChoice(name, 12, background=2))
    first, last = result.history[0], result.history[-1]
    assert len(result.history) == 12 == last.iteration == last.done
    assert last.residual < 0.5 * first.residual
    assert last.likelihood > first.likelihood
    assert nrmse(result.volume, truth) < 0.75
    assert result.volume.dtype == np.float32
    assert result.volume.min() >= 0


def test_acceleration_and_subsets_get_further_in_as_many_iterations(scene):
    P, _, image = scene
    likelihood = {
        n: reconstruct(P, image, SolverChoice(n, 12, background=2)).history[-1].likelihood
        for n in ("rl", "rl-biggs", "rl-nesterov", "osem")
    }
    assert all(likelihood[n] > likelihood["rl"] + 10 for n in ("rl-biggs", "rl-nesterov", "osem"))


def test_penalties_and_smoothing_keep_noise_out(scene):
    P, truth, image = scene
    error = {
        n: nrmse(reconstruct(P, image, SolverChoice(n, 40, background=2)).volume, truth)
        for n in ("rl", "rl-tv", "rl-tikhonov")
    }
    assert all(error[n] < 0.98 * error["rl"] for n in ("rl-tv", "rl-tikhonov"))


@pytest.mark.parametrize(
    "options", [{}, {"acceleration": "biggs-andrews"}, {"acceleration": "nesterov"}, {"subsets": 4}]
)
def test_a_resumed_run_equals_an_uninterrupted_one(scene, options):
    P, _, image = scene
    if "subsets" in options:
        options = {"subsets": interleaved_subsets(P.period, options["subsets"])}
    whole = richardson_lucy(P, image, 8, background=2, **options)
    work = iter_richardson_lucy(P, image, 8, background=2, **options)
    records = [next(work) for _ in range(5)]
    work.close()  # stopped by the user
    rest = richardson_lucy(P, image, 3, background=2, resume=records[-1].state, **options)
    assert np.array_equal(rest.volume, whole.volume)
    assert rest.history[-1].iteration == 8


def test_conjugate_gradients_resume(scene):
    P, _, image = scene
    whole = conjugate_gradient(P, image, 6, background=2)
    record = [r for _, r in zip(range(4), iter_conjugate_gradient(P, image, 6, background=2), strict=False)][-1]
    rest = conjugate_gradient(P, image, 2, background=2, resume=record.state)
    assert np.array_equal(rest.volume, whole.volume)


def test_tolerance_stops_early(scene):
    P, _, image = scene
    assert len(richardson_lucy(P, image, 50, background=2, tolerance=0.05).history) < 50


@pytest.mark.parametrize("penalty", [TotalVariation(1.0, 0.5), Tikhonov(1.0, 0.5)])
def test_penalty_gradients_are_derivatives(penalty):
    rng = np.random.default_rng(2)
    g, direction = rng.uniform(1, 2, (3, 6, 7)), rng.standard_normal((3, 6, 7))

    def steps(v):
        d = [np.diff(v, axis=a, append=np.take(v, [-1], axis=a)) for a in range(3)]
        d[0] = 0.5 * d[0]
        return d

    def value(v):
        square = sum(d * d for d in steps(v))
        return np.sqrt(square).sum() if isinstance(penalty, TotalVariation) else square.sum() / 2 / g.max()

    h = 1e-6
    slope = (value(g + h * direction) - value(g - h * direction)) / (2 * h)
    assert np.isclose(np.vdot(penalty.gradient(g), direction), slope, rtol=1e-4)


def test_subsets_split_the_phases():
    for masks in (interleaved_subsets((5, 7), 4), interleaved_subsets((2, 2), 4), angular_subsets((9, 7), (3, 2))):
        assert (np.sum(masks, axis=0) == 1).all()
    sizes = [int(m.sum()) for m in interleaved_subsets((12, 10), 5)]
    assert max(sizes) == min(sizes) == 24
    centre = angular_subsets((9, 9), (3, 3), (4, 4))[0]
    assert np.array_equal(np.argwhere(centre).mean(axis=0), (4, 4))


def test_views_are_ordered_by_their_light(scene):
    P, _, image = scene
    masks = by_energy(angular_subsets(P.period, (3, 3), (2, 2)), image, P.grid)
    light = [image[P.grid.tiled(m)].sum() for m in masks]
    assert light == sorted(light, reverse=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"iterations": 0}, "iterations"),
        ({"acceleration": "warp"}, "acceleration"),
        ({"subsets": interleaved_subsets((5, 5), 2)[:1]}, "each image phase exactly once"),
        ({"subsets": interleaved_subsets((5, 5), 2), "acceleration": "nesterov"}, "choose one"),
        ({"weights": -np.ones((60, 55))}, "weights"),
        ({"background": np.ones((3, 3))}, "background"),
        ({"initial": np.ones((1, 60, 55))}, "initial volume"),
        ({"relaxation": 0.0}, "relaxation"),
    ],
)
def test_bad_arguments_are_named(scene, options, message):
    P, _, image = scene
    with pytest.raises(InputError, match=message):
        richardson_lucy(P, image, **{"iterations": 2, **options})


@pytest.mark.parametrize("name", ["rl", "isra", "sieve"])
def test_an_image_that_tells_nothing_is_refused(name):
    """It had a volume of zeros, as if it were met exactly."""
    P, _, image, _ = tiny()
    with pytest.raises(NothingMeasured, match="expected light, got no pixel above 0"):
        reconstruct(P, 0 * image, SolverChoice(name))
    with pytest.raises(NothingMeasured, match="pixels to fit, got none; 72 non-finite pixels were left out"):
        reconstruct(P, np.nan * image, SolverChoice(name))
    with pytest.raises(NothingMeasured, match="got none; 72 saturated pixels were left out"):
        reconstruct(P, image, SolverChoice(name, saturation=0.5))
    with pytest.raises(NothingMeasured, match="pixels to fit, got none"):
        reconstruct(P, image, SolverChoice(name), weights=np.zeros(image.shape))
    with pytest.raises(NothingMeasured, match="expected a pixel of at least 1e-31, got no pixel above 1e-42"):
        reconstruct(P, image / image.max() * 1e-42, SolverChoice(name))
    with pytest.raises(InputError, match=r"image: expected counts up to 1e\+12, got 1e\+30; scale the frame"):
        reconstruct(P, image / image.max() * 1e30, SolverChoice(name))
    faint = reconstruct(P, image * 2.0**-90, SolverChoice(name, iterations=3)).volume
    usual = reconstruct(P, image, SolverChoice(name, iterations=3)).volume
    np.testing.assert_allclose(faint * 2.0**90, usual, rtol=1e-6, atol=1e-9 * usual.max())
    half = np.where(np.arange(8) < 4, image, 0)
    assert reconstruct(P, half, SolverChoice(name, iterations=1)).volume.any(), "a part of it has light"


@pytest.mark.parametrize(
    ("option", "value"),
    [("read_noise", np.nan), ("read_noise", -1.0), ("saturation", np.nan), ("saturation", 0.0)],
)
def test_counts_that_no_pixel_can_have_are_refused(option, value):
    P, _, image, _ = tiny()
    with pytest.raises(InputError, match=r"\(counts\)"):
        richardson_lucy(P, image, 1, **{option: value})


IGNORED = [
    ("isra", {"read_noise": 3.0}, "read noise"),
    ("rl", {"strength": 0.1}, "strength"),
    ("isra", {"subsets": 4}, "subsets"),
    ("rl-tv", {"subsets": 4}, "subsets"),
]


@pytest.mark.parametrize(("name", "option", "word"), IGNORED)
def test_settings_a_solver_would_ignore_are_refused(name, option, word):
    with pytest.raises(InputError, match=rf"{word}: expected none for solver {name}.*or choose .*(rl|osem)") as error:
        SolverChoice(name, **option)
    assert "\n" not in str(error.value)


def test_settings_that_say_nothing_are_none():
    for solver in SOLVERS:
        SolverChoice(solver.name, 5, 0.0, 0.0, None, None, None, 0.0)


def test_a_start_is_honoured_or_refused(scene):
    P, truth, image = scene
    for name in ("ems", "cg"):
        with pytest.raises(InputError, match=rf"solver: expected .*sieve.*, got '{name}'"):
            SolverChoice(name)
    cold, warm = (reconstruct(P, image, SolverChoice("isra", 1, 2.0), initial=g).history[0] for g in (None, truth))
    assert warm.residual < 0.5 * cold.residual


@pytest.mark.parametrize("name", SOLVERS.names())
def test_what_a_solver_honours_reaches_it(scene, name):
    """Every honoured option changes the result; a run that dropped one would not tell."""
    P, _, image = scene
    values = {
        "background": 2.0,
        "read_noise": 5.0,
        "saturation": float(np.quantile(image, 0.9)),
        "strength": 0.5,
        "subsets": 2,
    }
    plain = reconstruct(P, image, SolverChoice(name, 3)).volume
    solver = SOLVERS.get(name)
    for option, value in values.items():
        if option in solver.honours:
            changed = reconstruct(P, image, SolverChoice(name, 3, **{option: value})).volume
            assert not np.allclose(changed, plain, rtol=1e-4), option
    weights = (np.arange(image.size) % 3 > 0).reshape(image.shape)
    assert not np.allclose(reconstruct(P, image, SolverChoice(name, 3), weights=weights).volume, plain, rtol=1e-4)
    first = reconstruct(P, image, SolverChoice(name, 2))
    assert np.array_equal(reconstruct(P, image, SolverChoice(name, 1), resume=first.state).volume, plain)
    assert len(reconstruct(P, image, SolverChoice(name, 9, tolerance=10.0)).history) == 1


def test_an_image_of_another_size_is_refused(scene):
    P, _, image = scene
    with pytest.raises(InputError, match="make a projector for this size"):
        richardson_lucy(P, image[:-1], 2)
    with pytest.raises(InputError, match="solver"):
        SolverChoice("magic")


@pytest.mark.parametrize(
    ("columns", "settings", "message"),
    [
        (3, {}, r"image: expected 1 x 7 px, got 1 x 3 px; make a projector for this size"),
        (7, {"iterations": 0}, "iterations: expected at least 1, got 0; correct this value"),
        (7, {"damping": -0.5}, "damping: expected at least 0, got -0.5; correct this value"),
    ],
)
def test_conjugate_gradients_name_the_argument_that_is_out_of_range(
    columns: int, settings: dict[str, Any], message: str
) -> None:
    P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    with pytest.raises(InputError, match=f"^{message}$"):
        conjugate_gradient(P, np.ones((1, columns)), **settings)


@pytest.mark.parametrize("name", [solver.name for solver in SOLVERS])
@pytest.mark.parametrize("level", [0.0, -1.0])
def test_a_matrix_without_light_is_refused(name: str, level: float) -> None:
    projector = Projector(np.full((1, 2, 2, 3, 3), level, np.float32), (8, 8))
    with pytest.raises(InputError, match="PSF matrix: expected light from the volume on the image"):
        reconstruct(projector, np.ones((8, 8)), SolverChoice(name, 2))


SHARED = {"background": 0.0, "weights": None, "saturation": None, "tolerance": 0.0, "resume": None}
UPDATES = {"penalty": None, "acceleration": "none", "subsets": None, "relaxation": 1.0, "smoothing": None}


@pytest.mark.parametrize(
    ("solve", "own"),
    [
        (iter_richardson_lucy, {**UPDATES, "initial": None, "read_noise": 0.0}),
        (iter_isra, {**UPDATES, "initial": None}),
        (iter_conjugate_gradient, {"damping": 0.0}),
    ],
)
def test_solvers_take_the_fields_of_their_settings(solve: Callable[..., Any], own: dict[str, Any]) -> None:
    found = list(inspect.signature(solve).parameters.values())
    assert [one.name for one in found[:3]] == ["P", "image", "iterations"] and found[2].default == 20
    assert {one.name: one.default for one in found[3:]} == SHARED | own
    assert {one.kind for one in found[3:]} == {inspect.Parameter.KEYWORD_ONLY}


def test_solvers_refuse_what_is_not_in_their_settings() -> None:
    P, image = Projector(np.ones((1, 1, 1, 1, 1)), (2, 2)), np.ones((2, 2))
    least_squares: Any = isra
    with pytest.raises(TypeError, match="unexpected keyword argument 'read_noise'"):
        least_squares(P, image, read_noise=1.0)
    with pytest.raises(TypeError, match="positional argument"):
        least_squares(P, image, 2, 0.0)


def test_settings_of_solvers_are_listed_once() -> None:
    """Every list of settings builds on that of all solvers, and no solver lists them again."""
    base = {one.name for one in fields(SolverSettings)}
    assert base == SHARED.keys()
    kinds = [RichardsonLucySettings, IsraSettings, LeastSquaresSettings, SolverRun]
    for kind in kinds:
        assert issubclass(kind, SolverSettings) and not base & kind.__annotations__.keys()
    for kind in (EmOptions, IsraSettings):
        assert issubclass(kind, EmUpdates) and not UPDATES.keys() & kind.__annotations__.keys()
    for path in Path(inspect.getfile(SolverSettings)).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                assert len(node.args.args) + len(node.args.kwonlyargs) <= 10, (path.name, node.name)
