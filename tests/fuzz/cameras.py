"""Random cameras, from the ordinary to the extreme, with random effects, and what is wrong with their light."""

from __future__ import annotations

import dataclasses
import importlib
import math
import pkgutil
import time
import tracemalloc
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from lfcal.base.errors import InputError, LfcalError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Microscope, ScanPlan, Sensor
from lfcal.simulate import engines, simulate_psf
from lfcal.simulate.accuracy.forecast import predict_seconds
from lfcal.simulate.accuracy.memory import predict_bytes
from lfcal.simulate.effects import CATALOGUE, Effect

__all__ = ["MOST_MEMORY", "Trial", "random_trial", "verdict"]

MOST_MEMORY = 8 << 30
"""Bytes that no camera may need, by its forecast: it is not run then."""
WAVES = 0.6
"""Share of the trials that are computed by waves, whatever else their effects call for."""
BRIGHTEST = 1.005
"""Share of the light that a response may hold at most, beside the error that is stated."""


@dataclass(frozen=True)
class Trial:
    """One camera to simulate: a plan of few positions, effects and a tolerance."""

    seed: int
    plan: ScanPlan
    effects: tuple[Effect, ...]
    tolerance: float

    def __str__(self) -> str:
        camera = self.plan.camera
        return f"seed {self.seed}: {camera.optics} {camera.lattice} {self.plan.depths_um} {self.effects}"


OFF_THE_AXIS = ("field_aberrations",)
"""Effects that are nothing at the sensor's middle, where all of these cameras are scanned: seeds keep their cameras."""


def random_effects(rng: np.random.Generator) -> tuple[Effect, ...]:
    """Return up to four effects of the catalogue, magnitudes up to ten times the typical one either way."""
    names = [name for name in CATALOGUE.names() if name not in OFF_THE_AXIS]
    kinds = set(rng.choice(names, size=rng.integers(0, 5), replace=False))
    if rng.random() < WAVES:
        kinds |= {"lens_types", "lenslet_diffraction", "iris_diffraction"}
    return tuple(random_effect(CATALOGUE.get(str(name)), rng) for name in sorted(kinds))


def random_effect(kind: type[Effect], rng: np.random.Generator) -> Effect:
    """Return an effect whose numbers are drawn; those that it refuses stay as they are."""
    effect = kind()
    limits = getattr(kind, "limits", {})
    for field in dataclasses.fields(effect):  # type: ignore[arg-type]
        value = getattr(effect, field.name)
        if not isinstance(value, float) or isinstance(value, bool):
            continue
        low, high = limits.get(field.name, (-math.inf, math.inf))
        drawn = float(np.clip(value * 10 ** rng.uniform(-1, 1) * rng.choice([-1, 1]), low, high))
        try:
            effect = replace(effect, **{field.name: drawn})  # type: ignore[type-var]
        except InputError:
            continue
    return effect


def random_camera(rng: np.random.Generator) -> Camera:
    """Return a photographic camera or a microscope."""
    pixel = float(rng.uniform(1, 10))
    wavelength = float(rng.uniform(0.4, 0.9))
    pitch = pixel * float(rng.uniform(5, 40))
    optics: Any
    if rng.random() < 0.3:
        index = float(rng.choice([1.0, 1.33, 1.518]))
        aperture = float(rng.uniform(0.1, min(1.4, 0.99 * index)))
        magnification = float(rng.choice([4.0, 10.0, 20.0, 40.0, 60.0, 100.0]))
        optics, cone = Microscope(magnification, aperture, index), magnification / (2 * aperture)
    else:
        cone = float(10 ** rng.uniform(math.log10(1.4), math.log10(16)))
        focal = float(rng.uniform(10e3, 200e3))
        blades = int(rng.choice([0, 5, 6, 9]))
        optics = MainLens(
            focal, cone, focal * float(rng.uniform(3, 60)), blades=blades, blade_curvature=float(rng.random())
        )
    gap = pitch * cone * float(rng.uniform(0.6, 1.4))
    kind = str(rng.choice(["hexagonal", "square"]))
    count = int(rng.choice([1, 3])) if kind == "hexagonal" else 1
    types = tuple(LensType.focused_at(float(v), gap) for v in rng.uniform(1.5, 8, count))
    clear = None if rng.random() < 0.4 else pitch * float(rng.uniform(0.5, 1.0))
    turn = 0.0 if rng.random() < 0.5 else float(rng.uniform(-1.6, 1.6))
    lattice = LensletLattice(kind, pitch, gap, types, rotation_rad=turn, clear_um=clear)
    return Camera("drawn", optics, lattice, Sensor((600, 600), pixel), wavelength_um=wavelength)


def random_trial(seed: int) -> Trial:
    """Return the trial of a seed; draws that describe no camera, or no plan, are drawn again."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            camera = random_camera(rng)
            size = 2 * rng.integers(0, 51, 2) + 1
            if isinstance(camera.optics, Microscope):
                depths: dict[str, Any] = {"depths_um": [float(rng.choice([0.0, 1e-6, rng.uniform(-60, 60)]))]}
            else:
                v = rng.choice([0.0, 1e-9, rng.uniform(-1, 1), rng.uniform(-12, 12), rng.uniform(-300, 300)])
                depths = {"virtual_depths": [float(v)]}
            plan = ScanPlan.for_camera(camera, cutout=(int(size[0]), int(size[1])), **depths)
            effects = random_effects(rng)
        except InputError:
            continue
        return Trial(seed, replace(plan, period=(2, 2)), effects, float(rng.choice([0.1, 0.2])))


@cache
def _load_engines() -> None:
    """Load every engine: what code takes is no memory of a simulation."""
    for module in pkgutil.iter_modules(engines.__path__):
        importlib.import_module(f"{engines.__name__}.{module.name}")


def verdict(trial: Trial, *, timed: bool = False) -> tuple[str, str, float, float]:
    """Return what is wrong (empty: nothing), what it refused, CPU-seconds forecast and taken (0 unless ``timed``)."""
    plan = trial.plan
    arguments: dict[str, Any] = {"effects": trial.effects, "tolerance": trial.tolerance}
    wrong, forecast, taken = [], 0.0, 0.0
    _load_engines()
    if not timed:
        tracemalloc.start()
    try:
        allowed = predict_bytes(plan, workers=1, **arguments)
        if allowed > MOST_MEMORY:
            return "", f"not run: {allowed / 1e9:.3g} GB by the forecast", 0.0, 0.0
        if timed:
            forecast = predict_seconds(plan, **arguments)
        start = time.process_time()
        H = simulate_psf(plan, workers=1, **arguments)
        taken = time.process_time() - start
    except LfcalError as error:
        text = str(error)
        return ("" if "\n" not in text else f"a refusal of several lines: {text!r}"), text, 0.0, 0.0
    except Exception as error:
        return f"{type(error).__name__}: {error}", "", 0.0, 0.0
    finally:
        peak = tracemalloc.get_traced_memory()[1] if not timed else 0
        tracemalloc.stop()
    light = np.asarray(H[:], np.float64)
    if not np.isfinite(light).all():
        wrong.append("not finite")
    if light.min() < 0:
        wrong.append(f"negative: {light.min():.3g}")
    if (most := float(light.sum((-2, -1)).max())) > BRIGHTEST + float(np.nanmax(H.facts.known()["error"])):
        wrong.append(f"{most:.4g} of the light")
    if peak > allowed:
        wrong.append(f"{peak / 1e6:.0f} MB, {allowed / 1e6:.0f} by the forecast")
    return "; ".join(wrong), "", forecast, taken
