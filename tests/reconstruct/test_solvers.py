"""Solvers by plain algebra: updates, penalties, options, refusals, and their passes over planes."""

from __future__ import annotations

import inspect
import itertools
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import convolve1d, uniform_filter

from lfcal.base.errors import InputError
from lfcal.reconstruct import Projector
from lfcal.reconstruct.phantoms import nrmse, phantom
from lfcal.reconstruct.projectors import projector
from lfcal.reconstruct.solvers import measurement, planes
from lfcal.reconstruct.solvers._subsets import angular_subsets, by_energy, interleaved_subsets
from lfcal.reconstruct.solvers._update_kernels import squares_of, update_factors
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, reconstruct
from lfcal.reconstruct.solvers.image_space import isra, iter_isra
from lfcal.reconstruct.solvers.least_squares import conjugate_gradient, iter_conjugate_gradient
from lfcal.reconstruct.solvers.measurement import Measurement, NothingMeasured
from lfcal.reconstruct.solvers.multiplicative import iter_richardson_lucy, richardson_lucy
from lfcal.reconstruct.solvers.penalty import Tikhonov, TotalVariation
from lfcal.reconstruct.solvers.planes import UPDATING, box_mean, plane_threads, separable
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
def test_a_steep_penalty_changes_a_voxel_at_most_tenfold(penalty):
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


def test_the_names_of_solvers_are_kept():
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


def test_acceleration_and_penalties_are_better_than_plain_richardson_lucy(scene):
    P, truth, image = scene
    likelihood = {
        n: reconstruct(P, image, SolverChoice(n, 12, background=2)).history[-1].likelihood
        for n in ("rl", "rl-biggs", "rl-nesterov", "osem")
    }
    assert all(likelihood[n] > likelihood["rl"] + 10 for n in ("rl-biggs", "rl-nesterov", "osem"))
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


def test_conjugate_gradients_resume_and_a_tolerance_stops_early(scene):
    P, _, image = scene
    whole = conjugate_gradient(P, image, 6, background=2)
    record = [r for _, r in zip(range(4), iter_conjugate_gradient(P, image, 6, background=2), strict=False)][-1]
    rest = conjugate_gradient(P, image, 2, background=2, resume=record.state)
    assert np.array_equal(rest.volume, whole.volume)
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


def test_subsets_split_the_phases_and_are_ordered_by_their_light(scene):
    for masks in (interleaved_subsets((5, 7), 4), interleaved_subsets((2, 2), 4), angular_subsets((9, 7), (3, 2))):
        assert (np.sum(masks, axis=0) == 1).all()
    assert {int(m.sum()) for m in interleaved_subsets((12, 10), 5)} == {24}
    centre = angular_subsets((9, 9), (3, 3), (4, 4))[0]
    assert np.array_equal(np.argwhere(centre).mean(axis=0), (4, 4))
    P, _, image = scene
    masks = by_energy(angular_subsets(P.period, (3, 3), (2, 2)), image, P.grid)
    light = [image[P.grid.tiled(m)].sum() for m in masks]
    assert light == sorted(light, reverse=True)


def test_wrong_arguments_are_refused(scene):
    P, _, image = scene
    for options, message in (
        ({"iterations": 0}, "iterations"),
        ({"acceleration": "warp"}, "acceleration"),
        ({"subsets": interleaved_subsets((5, 5), 2)[:1]}, "each image phase exactly once"),
        ({"subsets": interleaved_subsets((5, 5), 2), "acceleration": "nesterov"}, "choose one"),
        ({"weights": -np.ones((60, 55))}, "weights"),
        ({"background": np.ones((3, 3))}, "background"),
        ({"initial": np.ones((1, 60, 55))}, "initial volume"),
        ({"relaxation": 0.0}, "relaxation"),
        ({"read_noise": np.nan}, r"\(counts\)"),
        ({"read_noise": -1.0}, r"\(counts\)"),
        ({"saturation": np.nan}, r"\(counts\)"),
        ({"saturation": 0.0}, r"\(counts\)"),
    ):
        with pytest.raises(InputError, match=message):
            richardson_lucy(P, image, **{"iterations": 2, **options})
    with pytest.raises(InputError, match="make a projector for this size"):
        richardson_lucy(P, image[:-1], 2)
    with pytest.raises(InputError, match="solver"):
        SolverChoice("magic")


@pytest.mark.parametrize("name", ["rl", "isra", "sieve"])
def test_an_image_without_information_is_refused(name):
    """A volume of zeros would seem to explain it exactly."""
    P, _, image, _ = tiny()
    small = image / image.max()
    for given, options, weights, what in (
        (0 * image, {}, None, "expected light, got no pixel above 0"),
        (np.nan * image, {}, None, "pixels to fit, got none; 72 non-finite pixels were left out"),
        (image, {"saturation": 0.5}, None, "got none; 72 saturated pixels were left out"),
        (image, {}, 0 * image, "pixels to fit, got none"),
        (small * 1e-42, {}, None, "expected a pixel of at least 1e-31, got no pixel above 1e-42"),
    ):
        with pytest.raises(NothingMeasured, match=what):
            reconstruct(P, given, SolverChoice(name, **options), weights=weights)
    with pytest.raises(InputError, match=r"image: expected counts up to 1e\+12, got 1e\+30; scale the frame"):
        reconstruct(P, small * 1e30, SolverChoice(name))
    faint = reconstruct(P, image * 2.0**-90, SolverChoice(name, iterations=3)).volume
    usual = reconstruct(P, image, SolverChoice(name, iterations=3)).volume
    np.testing.assert_allclose(faint * 2.0**90, usual, rtol=1e-6, atol=1e-9 * usual.max())
    half = np.where(np.arange(8) < 4, image, 0)
    assert reconstruct(P, half, SolverChoice(name, iterations=1)).volume.any(), "a part of it has light"


def test_settings_that_a_solver_would_ignore_are_refused():
    for name, option, word in (
        ("isra", {"read_noise": 3.0}, "read noise"),
        ("rl", {"strength": 0.1}, "strength"),
        ("isra", {"subsets": 4}, "subsets"),
        ("rl-tv", {"subsets": 4}, "subsets"),
    ):
        match = rf"^{word}: expected none for solver {name}[^\n]*or choose [^\n]*(rl|osem)[^\n]*$"
        with pytest.raises(InputError, match=match):
            SolverChoice(name, **option)
    for solver in SOLVERS:  # values that change nothing
        SolverChoice(solver.name, 5, 0.0, 0.0, None, None, None, 0.0)


def test_a_start_is_honoured_or_refused(scene):
    P, truth, image = scene
    for name in ("ems", "cg"):
        with pytest.raises(InputError, match=rf"solver: expected .*sieve.*, got '{name}'"):
            SolverChoice(name)
    cold, warm = (reconstruct(P, image, SolverChoice("isra", 1, 2.0), initial=g).history[0] for g in (None, truth))
    assert warm.residual < 0.5 * cold.residual


@pytest.mark.parametrize("name", SOLVERS.names())
def test_every_honoured_option_changes_the_result(scene, name):
    """Every honoured option changes the result, so that no run drops one silently."""
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


def test_wrong_arguments_of_conjugate_gradients_are_refused() -> None:
    P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    for columns, settings, message in (
        (3, {}, r"image: expected 1 x 7 px, got 1 x 3 px; make a projector for this size"),
        (7, {"iterations": 0}, "iterations: expected at least 1, got 0; correct this value"),
        (7, {"damping": -0.5}, "damping: expected at least 0, got -0.5; correct this value"),
    ):
        with pytest.raises(InputError, match=f"^{message}$"):
            conjugate_gradient(P, np.ones((1, columns)), **settings)


def test_a_matrix_without_light_is_refused() -> None:
    for level in (0.0, -1.0):
        projector = Projector(np.full((1, 2, 2, 3, 3), level, np.float32), (8, 8))
        for name in SOLVERS.names():
            with pytest.raises(InputError, match="PSF matrix: expected light from the volume on the image"):
                reconstruct(projector, np.ones((8, 8)), SolverChoice(name, 2))


SHARED = {"background": 0.0, "weights": None, "saturation": None, "tolerance": 0.0, "resume": None}
UPDATES = {"penalty": None, "acceleration": "none", "subsets": None, "relaxation": 1.0, "smoothing": None}


def test_solvers_have_the_fields_of_their_settings() -> None:
    for solve, own in (
        (iter_richardson_lucy, {**UPDATES, "initial": None, "read_noise": 0.0}),
        (iter_isra, {**UPDATES, "initial": None}),
        (iter_conjugate_gradient, {"damping": 0.0}),
    ):
        found = list(inspect.signature(solve).parameters.values())
        assert [one.name for one in found[:3]] == ["P", "image", "iterations"] and found[2].default == 20
        assert {one.name: one.default for one in found[3:]} == SHARED | own
        assert {one.kind for one in found[3:]} == {inspect.Parameter.KEYWORD_ONLY}
    P, image = Projector(np.ones((1, 1, 1, 1, 1)), (2, 2)), np.ones((2, 2))
    least_squares: Any = isra
    with pytest.raises(TypeError, match="unexpected keyword argument 'read_noise'"):
        least_squares(P, image, read_noise=1.0)
    with pytest.raises(TypeError, match="positional argument"):
        least_squares(P, image, 2, 0.0)


PLANES = [(1, 1), (1, 7), (5, 1), (40, 33)]


@pytest.mark.parametrize(("dtype", "off"), [(np.float32, 1e-6), (np.float64, 1e-13)])
def test_filters_of_planes_are_those_of_scipy(dtype, off):
    def check(found, truth):
        assert (found.dtype, found.shape) == (np.dtype(dtype), truth.shape)
        assert np.abs(found - truth).max() <= off * np.abs(truth).max()

    for shape in PLANES:
        plane = (1000 * np.random.default_rng(0).random(shape)).astype(dtype)
        for window in ((1, 1), (3, 3), (4, 6), (55, 95)):
            check(box_mean(plane, window), uniform_filter(plane.astype(float), window, mode="nearest"))
        for size in (1, 5, 59):
            kernel = np.exp(-(np.linspace(-2, 2, size) ** 2))
            kernel /= kernel.sum()
            truth = plane.astype(float)
            for axis in (0, 1):
                truth = convolve1d(truth, kernel, axis=axis, mode="constant")
            check(separable(plane, kernel), truth)


@pytest.mark.parametrize("name", ["sieve", "rl-biggs", "isra"])
def test_threads_change_no_bit_of_a_reconstruction(name, monkeypatch):
    H, image = lenslet_psf(3, 5, 15), np.random.default_rng(1).random((41, 37))
    limits = ((measurement, "BAND", 100), (measurement, "LARGE", 0), (planes, "LEAST", 0), (projector, "LARGE", 0))
    for module, limit, value in limits:
        monkeypatch.setattr(module, limit, value)
    volumes, ends = [], []
    for workers in ("1", "3"):
        monkeypatch.setenv("LFCAL_WORKERS", workers)
        found = reconstruct(Projector(H, image.shape, workers=int(workers)), image, SolverChoice(name, 4))
        volumes.append(found.volume)
        ends.append([(one.residual, one.change, str(one.likelihood)) for one in found.history])
    np.testing.assert_array_equal(*volumes)
    assert ends[0] == ends[1]


def test_fit_is_the_deviance_by_its_definition(monkeypatch):
    rng = np.random.default_rng(3)
    monkeypatch.setattr(measurement, "BAND", 60)  # the last of seven bands is shorter
    data, model = rng.poisson(3, (20, 19)).astype(float), rng.random((20, 19)) + 0.5
    model[3, 4] = 0  # under a lit pixel: the floor takes its place
    data[3, 4] = 2
    for masked, weighted, held in itertools.product((False, True), repeat=3):
        mask = rng.random(data.shape) < 0.6 if masked else None
        weights = rng.random(data.shape) if weighted else None
        out = rng.random(data.shape) < 0.2 if held else None
        measured = Measurement.of(data, dtype=np.float64, weights=weights, held_out=out)
        trust = (1.0 if weights is None else weights) * (1.0 if mask is None else mask) * np.ones_like(data)
        m = np.maximum(model, 1e-3)
        terms = m - data + np.where(data > 0, data * np.log(np.where(data > 0, data, 1) / m), 0)
        kept = trust if out is None else trust * ~out
        found = measured.fit(model, mask, 1e-3)
        assert found.likelihood == pytest.approx(-(kept * terms).sum(), rel=1e-12)
        norm = np.sqrt((kept * data**2).sum())
        assert found.residual == pytest.approx(np.sqrt((kept * (data - model) ** 2).sum()) / norm, rel=1e-12)
        if out is None:
            assert np.isnan(found.held_out)
        else:
            assert found.held_out == pytest.approx(-(trust * out * terms).sum(), rel=1e-12)
            assert found.held_out_error > 0


def test_as_many_planes_at_once_as_memory_allows(monkeypatch):
    monkeypatch.setenv("LFCAL_WORKERS", "16")
    assert plane_threads(11, 10**5) == 1, "small planes"
    monkeypatch.setattr(planes, "LEAST", 0)
    monkeypatch.setattr(planes, "free_memory", lambda: 10 * 1000 * UPDATING)
    assert plane_threads(11, 100) == 10
    assert plane_threads(3, 1) == 3
    assert plane_threads(11, 10**6) == 1
    monkeypatch.setenv("LFCAL_WORKERS", "2")
    assert plane_threads(11, 1) == 2


def test_compiled_passes_over_planes_agree_with_numpy() -> None:
    for kind in (np.float32, np.float64):
        rng = np.random.default_rng(0)
        above, share, sensitivity = (rng.normal(0.5, 1, (30, 41)).astype(kind) for _ in range(3))
        share[3, 4], above[5, 6] = 0, np.nan
        seen = (sensitivity > 0.2) & (share > 0)
        wanted = np.divide(np.maximum(above, 0), share, out=np.ones_like(above), where=seen)
        out = np.empty_like(above)
        update_factors(above, share, sensitivity, 0.2, out)
        np.testing.assert_array_equal(out, wanted)
        size, change = squares_of(share, sensitivity)
        assert size == pytest.approx(np.square(share, dtype=np.float64).sum(), rel=1e-12)
        assert change == pytest.approx(np.square(share - sensitivity, dtype=np.float64).sum(), rel=1e-12)
