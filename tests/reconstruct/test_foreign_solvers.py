"""Solvers of other distributions: the documented one is complete, and broken ones are left out with a reason."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.cli import main
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector, SolverChoice, reconstruct
from lfcal.reconstruct.solvers import choice
from lfcal.reconstruct.solvers.choice import find_solvers, iter_reconstruct
from lfcal.reconstruct.solvers.solver import OPTIONS, Solver, SolverRun
from tests.distribution import code_of, in_a_new_process, install
from tests.reconstruct.oracles import dense, lenslet_psf

PAGE = code_of("extending.md", "A solver")


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """Install a solver of another distribution for one test."""

    def put(source, name="SOLVER"):
        install(monkeypatch, tmp_path, "their_solver", source, {"lfcal.solvers": f"theirs = their_solver:{name}"})
        solvers = find_solvers()
        monkeypatch.setattr(choice, "SOLVERS", solvers)
        monkeypatch.setattr("lfcal.reconstruct.SOLVERS", solvers)

    return put


@pytest.fixture
def run(capfd, monkeypatch):
    def call(*arguments):
        words = arguments if arguments == ("solvers",) else ("reconstruct", *arguments)
        monkeypatch.setattr("sys.argv", ["lfcal", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        return (int(end.value.code or 0), *capfd.readouterr())

    return call


def test_the_documented_solver_minimises_squares(foreign):
    foreign(PAGE[0])
    rng = np.random.default_rng(0)
    H = rng.random((1, 2, 2, 3, 3))
    P, A = Projector(H, (9, 8), dtype=np.float64), dense(H, (9, 8))
    truth = rng.uniform(1, 5, A.shape[1])
    image = (A @ truth + 2.0).reshape(9, 8)
    step = 1 / (A.T @ (A @ np.ones(A.shape[1]))).max()
    g = np.zeros(A.shape[1])
    for _ in range(200):
        g = np.maximum(g + step * A.T @ (image.ravel() - 2.0 - A @ g), 0)
    names = {"P": P, "image": image, "reconstruct": reconstruct, "SolverChoice": SolverChoice}
    exec(PAGE[1], names)  # the section's second block
    result = names["result"]
    assert np.allclose(result.volume.ravel(), g, rtol=1e-10)
    assert result.history[-1].residual < 0.1 * result.history[0].residual and len(result.history) == 200


def test_the_documented_solver_stops_resumes_and_masks(foreign):
    foreign(PAGE[0])
    P = Projector(lenslet_psf(2, 5, 15), (30, 31))
    rng = np.random.default_rng(1)
    image = rng.poisson(50, (30, 31)).astype(float)
    image[4, 4], image[9, 9] = np.nan, 1e9
    whole = reconstruct(P, image, SolverChoice("landweber", 6, saturation=1e6))
    work = iter_reconstruct(P, image, SolverChoice("landweber", 6, saturation=1e6))
    records = [next(work) for _ in range(4)]
    work.close()
    rest = reconstruct(P, image, SolverChoice("landweber", 2, saturation=1e6), resume=records[-1].state)
    assert np.array_equal(rest.volume, whole.volume) and rest.history[-1].iteration == 6
    assert np.isfinite(whole.volume).all() and len(whole.notes) == 2
    assert len(reconstruct(P, image, SolverChoice("landweber", 6, tolerance=9.0)).history) == 1


def test_options_it_does_not_honour_are_refused(foreign):
    foreign(PAGE[0])
    with pytest.raises(InputError, match=r"read noise: expected none for solver landweber.*or choose rl"):
        SolverChoice("landweber", read_noise=2.0)
    P = Projector(lenslet_psf(2, 5, 15), (30, 31))
    with pytest.raises(InputError, match=r"initial: expected none for solver landweber"):
        reconstruct(P, np.ones((30, 31)), SolverChoice("landweber"), initial=np.ones(P.volume_shape))


def test_the_command_line_runs_it(foreign, run, tmp_path):
    foreign(PAGE[0])
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H), tmp_path / "H.h5")
    frame = np.maximum(Projector(H, (30, 31)).forward(np.full((2, 30, 31), 900.0)), 0).astype(np.uint16)
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    arguments = (tmp_path / "H.h5", tmp_path / "frame.tif", "-o", tmp_path / "v.tif")
    code, out, err = run(*arguments, "--solver", "landweber", "-n", 3)
    assert code == 0, err
    assert "3 iterations" in out and tifffile.imread(tmp_path / "v.tif").max() > 0
    code, out, _ = run("solvers")
    assert code == 0 and "landweber" in out and "Landweber 1951" in out
    code, _, err = run(*arguments, "--solver", "landweber", "--read-noise", 3)
    assert code == 2 and "--read-noise: expected --solver sieve, rl, " in err and len(err.strip().splitlines()) == 1


def test_the_window_lists_it(foreign, tmp_path):
    foreign(PAGE[0])
    code = """
from lfcal_gui.pages.reconstruct.model import FIELDS, ReconstructSettings, used_by
assert "landweber" in dict(FIELDS[0].choices) and "Landweber 1951" in FIELDS[0].tip
assert used_by("landweber", "background") and not used_by("landweber", "read_noise")
print(ReconstructSettings("landweber", read_noise=3.0).choice().solver.title)
"""
    assert "projected gradient" in in_a_new_process(tmp_path, code)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("SOLVER = 3", "expected a part with a name"),
        ("class SOLVER:\n    name = 'theirs'", "expected a Solver with a function"),
        (PAGE[0].replace('frozenset({"background",', 'frozenset({"backgrounds",'), "backgrounds"),
        ("import a_library_that_is_missing", "a_library_that_is_missing"),
    ],
)
def test_broken_solvers_are_left_out_with_a_reason(foreign, run, source, reason):
    own = find_solvers().names()
    foreign(source)
    assert choice.SOLVERS.names() == own
    assert reason in choice.SOLVERS.failures()["theirs"]
    code, out, err = run("solvers")
    assert code == 0 and "rl-tv" in out and "solver theirs" in err


def test_own_solvers_cannot_be_replaced(foreign):
    foreign(PAGE[0].replace('"landweber", "least', '"rl", "least'))
    assert "Eberhart" in choice.SOLVERS.get("rl").title


def test_a_run_has_every_option_at_its_idle_value():
    run = SolverRun(3)
    assert {name: getattr(run, name) for name in OPTIONS} == OPTIONS
    with pytest.raises(InputError, match="options of solver x"):
        Solver("x", "x", lambda P, image, run: iter(()), frozenset({"speed"}))
