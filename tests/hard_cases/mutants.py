"""Naive implementations of all hard cases in optics, sampling and specimens, which the cases must detect."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest
from scipy.special import jv

from lfcal.base.errors import InputError
from lfcal.camera import LensletLattice
from lfcal.simulate.engines import (
    _debye as debye,
)
from lfcal.simulate.engines import (
    _geometric as geometric,
)
from lfcal.simulate.engines import (
    _nodes as nodes,
)
from lfcal.simulate.engines import (
    _polygon as polygon,
)
from lfcal.simulate.engines import (
    _radial as radial,
)
from lfcal.simulate.engines import (
    _tails as tails,
)
from lfcal.simulate.engines import (
    _wave as wave,
)
from lfcal.simulate.engines import (
    base,
    extent,
    field,
    grid,
    microscope,
    reference,
    tables,
)
from lfcal.simulate.engines.base import EnergyError
from lfcal.simulate.scene import Scene
from tests.hard_cases import test_optics as optics
from tests.hard_cases import test_sampling as sampling
from tests.hard_cases import test_specimen as specimen
from tests.hard_cases.rewrite import Mutant, rewritten

__all__ = ["MUTANTS"]

Patch = pytest.MonkeyPatch


def value(owner: Any, name: str, to: Any) -> Any:
    """Return a function that sets ``owner.name``."""
    return lambda patch: patch.setattr(owner, name, to)


def lommel(u: float, v: np.ndarray) -> np.ndarray:
    """Return the field near focus by Lommel's series, Born and Wolf 8.8 eq. (13) and (18), for u < v."""
    series = [sum((-1) ** s * (u / v) ** (n + 2 * s) * jv(n + 2 * s, v) for s in range(20)) for n in (1, 2)]
    return 2 / u * np.exp(-0.5j * u) * (series[0] + 1j * series[1])


def every_lenslet(patch: Patch) -> None:
    """List every lenslet of the shadow; a list of billions raises an error before it needs the memory."""
    rewritten(
        geometric.GeometricPlane,
        "_visible_reach",
        ("return min(self._reach, shown /", "return max(self._reach, shown /"),
    )(patch)
    listed = LensletLattice.lenslets_within

    def counted(self: LensletLattice, width: float, height: float, about: tuple[float, float] = (0.0, 0.0)) -> Any:
        if width * height > 1e7 * self.pitch_um**2:
            raise MemoryError
        return listed(self, width, height, about)

    patch.setattr(LensletLattice, "lenslets_within", counted)


def one_target(patch: Patch) -> None:
    """Make all threads add to the same arrays."""
    made: list[Any] = []
    target, add = wave.WavePlane._target, wave.WavePlane._add_lens

    def shared(self: wave.WavePlane, image: Any, count: int) -> Any:
        made.append(target(self, image, count))
        return made[0]._replace(image=image)

    def slow(self: wave.WavePlane, *args: Any) -> Any:
        spots = add(self, *args)
        time.sleep(1e-3)  # the next thread's turn
        return spots

    patch.setattr(wave.WavePlane, "_target", shared)
    patch.setattr(wave.WavePlane, "_add_lens", slow)


def hard_disc(radius: float, dx: float, reach: float) -> tuple[np.ndarray, float]:
    """Return the disc with hard edges, as a function of r^2."""
    step = 2 * radius * dx / 128
    return (step * np.arange(math.ceil(reach**2 / step) + 2) <= radius**2).astype(float), step


MUTANTS = (
    Mutant(
        "Source on the native plane", "1/a is formed", value(wave, "choose_mode", lambda scene: "E"), ZeroDivisionError
    ),
    Mutant(
        "A nanometre from the native plane",
        "1/a is formed where a is not exactly 0",
        value(wave, "choose_mode", lambda scene: "E" if scene.image_um else "U"),
        long=True,
    ),
    Mutant(
        "Native plane, rays only",
        "the shadow is drawn by its density, whatever its size",
        rewritten(geometric.GeometricPlane, "__init__", ("lens_is_smaller = ", "lens_is_smaller = True or ")),
        ZeroDivisionError,
    ),
    Mutant(
        "Inside the iris's depth of focus (Fresnel number 1)",
        "the sphere is taken off wherever 1/a is finite",
        value(field, "SWITCH", 0.1),
    ),
    Mutant("Change from near to far field", "the method changes at Fresnel number 3", value(field, "SWITCH", 3.0)),
    Mutant(
        "Spots of neighbouring lenslets overlap",
        "intensities are always added",
        value(wave.WavePlane, "_overlap", lambda self: False),
    ),
    Mutant(
        "Source on the native plane",
        "intensities are always added",
        value(wave.WavePlane, "_overlap", lambda self: False),
    ),
    Mutant(
        "Lenslet exactly in focus, rays only",
        "a spot has the size that sigma says",
        value(geometric, "LEAST_SPOT_PX", 0.0),
        ZeroDivisionError,
    ),
    Mutant(
        "Lenslet exactly in focus",
        "the window follows sigma at once",
        rewritten(tables, "window_of", ("math.ceil(extent / px - 1e-3)", "math.ceil(extent / px)")),
    ),
    Mutant(
        "Iris smaller than a lenslet",
        "windows follow the lenslet's centre",
        rewritten(tables, "_spot", ("gap * cone), at_infinity", "gap * cone), 0.0")),
    ),
    Mutant(
        "On-axis null (u = 4 pi)",
        "the field is divided by its value on the axis",
        value(optics, "focus_integral", lambda u, v: radial.focus_integral(u, v) / radial.focus_integral(u, v)[0]),
        AssertionError,
    ),
    Mutant(
        "Defocus of exactly zero in the focal integral",
        "Lommel's series",
        value(optics, "focus_integral", lommel),
        ZeroDivisionError,
    ),
    Mutant("Debye integral far from focus", "40 nodes", value(debye, "debye_nodes", lambda scene, r: 40)),
    Mutant(
        "NA within 1e-6 of the index",
        "nodes are spread evenly in the angle",
        rewritten(debye, "_sections", ("critical * (1 - s * s), 2 * critical * w * s", "critical * s, critical * w")),
    ),
    Mutant(
        "Specimen's index below the NA",
        "one section over the branch point",
        rewritten(
            debye,
            "_sections",
            ("critical = min(alpha, math.asin(specimen.index / optics.medium_index))", "critical = alpha"),
        ),
    ),
    Mutant(
        "Phase of a specimen that nearly matches",
        "n2 cos t2 - n1 cos t as it is written",
        rewritten(
            specimen,
            "pupil_phase",
            ("(n2 - n1) * (1 + (n2 + n1) / (second + first)) / (n1 + first)", "(second - first - n2 + n1) / fall"),
        ),
    ),
    Mutant("Second Bessel function next to the axis", "the recurrence everywhere", value(radial, "SMALL", 1e-300)),
    Mutant(
        "Sphere minus its parabola",
        "1 - sqrt(1 - s) - s/2 as it is written",
        rewritten(
            optics,
            "wavefront_waves",
            ("sine2**2 / (2 * (1 + np.sqrt(1 - sine2)) ** 2)", "(1 - np.sqrt(1 - sine2) - sine2 / 2)"),
        ),
    ),
    Mutant(
        "Evanescent waves",
        "the root of a negative number",
        value(
            optics,
            "sensor_propagator",
            lambda f, lam, gap, exact: (
                np.exp(2j * np.pi * gap * (np.sqrt(1 / lam**2 - f[:, None] ** 2 - f**2) - 1 / lam)),
                False,
            ),
        ),
        AssertionError,
    ),
    Mutant(
        "Polygon's transform at zero frequency",
        "the edge form without the 1 taken from each term",
        rewritten(polygon, "transform", ("* (1 + turned) + turned)", "* (1 + turned) + turned + 1)")),
    ),
    Mutant(
        "Nothing passes the iris",
        "the field is divided by its energy",
        rewritten(
            field,
            "_made",
            ("np.zeros((4, 4), np.complex128)", "np.zeros((4, 4), np.complex128) / np.zeros(1)"),
        ),
    ),
    Mutant(
        "Lenslets that miss the cutout",
        "the largest of no ratios",
        rewritten(
            wave.WavePlane,
            "_add_lens",
            ("if found:\n", "if spots['energy_in'].max() >= 0:\n"),
        ),
        ValueError,
    ),
    Mutant(
        "Enormous defocus (v = 1e4)",
        "a table of the whole shadow",
        rewritten(field, "_envelope", ("local = max(half, box) < reach", "local = False")),
        InputError,
    ),
    Mutant("Extreme defocus (v = 1e12), rays only", "every lenslet of the shadow", every_lenslet, MemoryError),
    Mutant(
        "Eight waves of spherical aberration",
        "windows for rays without aberration",
        value(tables, "ray_aberration", lambda scene: 0.0),
        EnergyError,
    ),
    Mutant(
        "Blades that are almost straight, almost round",
        "the blade's radius from the chord's apothem",
        rewritten(
            polygon,
            "_blade_radius",
            ("apothem = 1.0 + r - math.sqrt(max(0.0, r * r - chord * chord / 4))", "apothem = 1.0"),
        ),
    ),
    Mutant(
        "Denormal inputs",
        "1/a is formed where a is not exactly 0",
        value(wave, "choose_mode", lambda scene: "E" if scene.image_um else "U"),
        ZeroDivisionError,
    ),
    Mutant(
        "Lenslets four times as high as wide",
        "square cells",
        rewritten(tables, "aperture_outline", ("scene.lattice.basis_um()", "scene.lattice.pitch_um * np.eye(2)")),
    ),
    Mutant(
        "Displacement by half a pixel",
        "the cutout's middle at half its width",
        rewritten(reference.ReferencePlane, "_respond", ("(count // 2) * self.per_px", "count / 2 * self.per_px")),
    ),
    Mutant(
        "Window wider than lambda B / (2 dx)",
        "one sample per pixel",
        value(tables, "_fewest_samples", lambda scene, mode, half_px: 1.0),
        EnergyError,
    ),
    Mutant("Hard-edged apertures", "a hard mask", value(sampling, "disc_table", hard_disc)),
    Mutant(
        "Single precision in the far field",
        "the phase of the way from lenslet to sensor, k B, is kept",
        rewritten(
            tables,
            "zoom_of",
            (
                "angle = np.outer(nodes[nodes.size // 2 :], rates)",
                "angle = (np.outer(nodes[nodes.size // 2 :], rates) + 4712).astype(dtype) - dtype(4712)",
            ),
        ),
        long=True,
    ),
    Mutant(
        "Single precision far from the origin",
        "positions in single precision",
        rewritten(
            wave.WavePlane,
            "_respond",
            (
                "np.ascontiguousarray(source_yx[:, ::-1])",
                "np.ascontiguousarray(source_yx[:, ::-1]).astype(np.float32).astype(float)",
            ),
        ),
    ),
    Mutant(
        "Denormal numbers in a matrix",
        "what is too small to matter is kept",
        rewritten(
            microscope, "_parts", ("    parts[np.abs(parts) < 1e-12 * np.abs(parts).max(initial=0.0)] = 0\n", "")
        ),
    ),
    Mutant("Matrix products within threads", "larger pieces", value(sampling.kernels, "_SMALL", 1 << 20)),
    Mutant(
        "Cutout of one pixel",
        "lenslets over the cutout alone",
        rewritten(geometric.GeometricPlane, "_visible_reach", (" + spot + scene.reduced_pixel_um", "")),
    ),
    Mutant(
        "Cutouts of extreme shape",
        "columns before rows",
        rewritten(wave.WavePlane, "_add_lens", ("lens.width, *scene.cutout,", "lens.width, *scene.cutout[::-1],")),
    ),
    Mutant(
        "Period of one position",
        "positions from 0 up to the last",
        rewritten(base.Pilot, "seconds", ("np.linspace(0, nx - 1, min(nx, self._columns))", "np.arange(0, nx - 1)")),
        IndexError,
    ),
    Mutant(
        "Cutout smaller than the pattern",
        "a grid as large as the cutout",
        rewritten(extent.Extent, "side", ("half = max(lit, reach, min(", "half = min(reach, min(")),
    ),
    Mutant(
        "Even and odd numbers of samples per pixel",
        "a pixel's middle is a sample",
        rewritten(grid.GridPlane, "__init__", ("0.5 if self.per_px % 2 == 0 else 0.0", "0.0")),
    ),
    Mutant(
        "Few samples per pixel",
        "weights as the fit leaves them",
        value(nodes, "conserving", lambda rule: rule),
        EnergyError,
    ),
    Mutant(
        "Fast lens on the native plane, exact angles",
        "the Fresnel integral",
        rewritten(grid.GridPlane, "_transfer", ("scene.exact_rays, glass", "False, glass")),
    ),
    Mutant("Threads", "one scratch array for all", one_target),
    Mutant(
        "Chief ray on the border of two pixels",
        "the pixel by cutting off digits",
        value(Scene, "nearest_pixel", lambda self, y, x: (int(y / self.row_um), int(x / self.pixel_um))),
    ),
    Mutant("Windows a pixel wider than the spots", "no tails", value(tails, "add_tails", lambda *given: None)),
    Mutant(
        "Squares of faint responses",
        "responses are divided by the shadow's area in µm^2 once more",
        rewritten(
            geometric.GeometricPlane,
            "__init__",
            ("1 / (math.pi * (a * cone) ** 2)", "1 / (math.pi * (a * cone) ** 2) ** 2"),
        ),
    ),
)
