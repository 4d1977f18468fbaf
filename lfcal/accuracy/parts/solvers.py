"""Solvers: error of the reconstruction of a known volume versus time of the iterations."""

from __future__ import annotations

import time

import numpy as np

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import LfcalError
from lfcal.camera import Sensor
from lfcal.reconstruct import SOLVERS, Projector, SolverChoice, iter_reconstruct, nrmse, phantom

__all__ = ["PART"]

SHOWN = (1, 2, 5, 10, 20, 40, 80)
"""Iterations at which the volume is compared with the truth."""

PLANES, SIDE = 3, 128
FULL = 0.8
"""Fraction of the full well that the brightest pixel reaches."""

SHARE = 0.2
"""Fraction of the time that one solver may use, so that others can be measured too."""


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error and time of reconstructing a known volume from its noisy image, with each solver.

    There is a point for each number of iterations in `SHOWN` that a solver reaches in its fraction of the time limit.
    """
    sample = yield from subject.iter_sample(PLANES)
    H = sample.matrix
    yield AccuracyStep("projector")
    shape = (max(SIDE, H.shape[1] + H.shape[3]), max(SIDE, H.shape[2] + H.shape[4]))
    exact = Projector(H, shape, dtype=np.float64, workers=subject.workers)
    truth = phantom("vesicle", exact.volume_shape)
    clean = np.maximum(exact.forward(truth), 0)
    sensor = Sensor() if H.camera is None else H.camera.sensor
    # volume and image are scaled together, so that the error is in the same electrons
    scale = FULL * sensor.full_well_e / float(clean.max())
    rng = np.random.default_rng(1)
    image = rng.poisson(clean * scale) + rng.normal(0, sensor.read_noise_e, clean.shape)
    start = time.perf_counter()
    P = Projector(H, shape, workers=subject.workers).prepare()
    setup = time.perf_counter() - start
    yield Truth(
        f"the volume itself, a hollow sphere of {'x'.join(map(str, truth.shape))} voxels",
        (
            *sample.notes,
            f"image of {shape[0]} x {shape[1]} px with photon and read noise, brightest pixel at "
            f"{100 * FULL:g} % of {sensor.full_well_e:g} e-",
        ),
    )
    for name in SOLVERS.names():
        yield AccuracyStep(name)
        yield from _solved(P, image, truth * scale, name, setup, SHARE * seconds)


def _solved(P: Projector, image: np.ndarray, truth: np.ndarray, name: str, setup: float, seconds: float) -> Measuring:
    """Yield a point at every iteration of `SHOWN` that a solver reaches within the time limit."""
    work = iter_reconstruct(P, image, SolverChoice(name, SHOWN[-1]))
    start = time.perf_counter()
    try:
        for record in work:
            if record.iteration not in SHOWN or record.state is None:
                continue
            error = nrmse(record.state.volume, truth)
            settings = {"solver": name, "iterations": record.iteration}
            others = {"iterations": float(record.iteration), "preparing (s)": setup}
            words = f"{name}, {record.iteration} iteration{'s' * (record.iteration > 1)}"
            yield CostPoint(words, settings, error, record.seconds, "seconds", others)
            if time.perf_counter() - start > seconds:
                return
            yield AccuracyStep(f"{name}, further iterations", 0.0)
    except LfcalError as error:  # a solver of another package may require more than an image
        yield AccuracyStep(f"{name}: {error}", 0.0)
    finally:
        work.close()


PART = AccuracyPart(
    "solvers",
    "Reconstruction: solver and iterations",
    "rms error of the volume, relative to the rms of the true volume",
    "time of the iterations",
    "seconds",
    measure,
    rank=80,
)
