"""Faults with which inspections are tested: one line each, with three strengths and the function that adds it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from benchmarks._fault_optics import (
    blurred_type,
    deep,
    dim_type,
    equalised,
    flicker,
    focus,
    ghost,
    jump,
    lit,
    odd,
    shadow,
    swapped_planes,
    warming,
)
from benchmarks._fault_recordings import PutIn
from benchmarks._fault_scan import (
    blank,
    doubled,
    drift,
    late,
    lines_swapped,
    mirrored,
    play,
    repeated,
    scattered,
    screw,
    some,
    sources,
    swapped,
    unwound,
    whole,
)
from benchmarks._fault_sensor import (
    bent,
    clipped,
    compressed,
    dead_pixels,
    dim,
    dust,
    few_saturated,
    glow,
    halved,
    hot,
    hot_pixels,
    lifted,
    mosaic,
    offsets,
    sagging,
    saturated,
)

__all__ = ["FAULTS", "Injected"]


@dataclass(frozen=True, eq=False)
class Injected:
    """A fault that is added to a recording.

    Attributes
    ----------
    name, unit
        The fault, and the unit of its strengths.
    strengths
        Three, from weak to strong.
    named
        Names of the findings, or keys of the metrics, that count as identification.
    put_in
        Function that returns the recording ``(nz, ny, nx, nt, ns)`` with the fault at a strength.
    types
        Number of lens types that a camera must have.
    """

    name: str
    unit: str
    strengths: tuple[float, float, float]
    named: tuple[str, ...]
    put_in: PutIn
    types: int = 1


def _faults() -> Iterator[Injected]:
    def one(name: str, unit: str, strengths: tuple[float, float, float], named: str, put_in: PutIn) -> Injected:
        return Injected(name, unit, strengths, tuple(named.split()), put_in, 3 if "lens type" in name else 1)

    scan, axes = "strangers misplaced scan_order order", "stage_axes"
    yield one("dead column", "of the light", (0.5, 0.8, 1.0), "dead_line", dim(1))
    yield one("dead row", "of the light", (0.5, 0.8, 1.0), "dead_line", dim(0))
    yield one("two dead columns apart", "of the light", (0.5, 0.8, 1.0), "dead_line", dim(1, 0.4, 0.6))
    yield one("two dead columns together", "of the light", (0.5, 0.8, 1.0), "dead_line", dim(1, 0.45, 0.465))
    yield one("dim column", "of the light", (0.1, 0.2, 0.3), "dead_line", dim(1))
    yield one("dim row", "of the light", (0.1, 0.2, 0.3), "dead_line", dim(0))
    yield one("hot column", "of the peak", (0.003, 0.01, 0.03), "hot_line", hot(1))
    yield one("hot row", "of the peak", (0.003, 0.01, 0.03), "hot_line", hot(0))
    yield one("two hot columns", "of the peak", (0.003, 0.01, 0.03), "hot_line", hot(1, 0.4, 0.6))
    yield one("offsets of rows", "counts", (2, 5, 15), "line_offsets", offsets(0))
    yield one("offsets of columns", "counts", (2, 5, 15), "line_offsets", offsets(1))
    yield one("dead pixels", "pixels", (1, 4, 12), "bad_pixels hot_pixels", dead_pixels)
    yield one("hot pixel", "of the peak", (0.05, 0.2, 0.8), "bad_pixels hot_pixels", hot_pixels(1))
    yield one("eight hot pixels", "of the peak", (0.02, 0.1, 0.4), "bad_pixels hot_pixels", hot_pixels(8))
    yield one("hot pixels together", "of the peak", (0.02, 0.1, 0.4), "bad_pixels", hot_pixels(6, together=True))
    yield one("dust on the sensor", "of the light", (0.3, 0.6, 0.95), "bad_pixels dead_line", dust)
    yield one("Bayer mosaic", "of the filters", (0.2, 0.5, 1.0), "mosaic", mosaic(0.6, 1.0, 1.0, 0.5))
    yield one("mosaic with one odd pixel", "of the filter", (0.2, 0.5, 1.0), "mosaic", mosaic(0.4, 1.0, 1.0, 1.0))
    yield one("columns by turns", "of the light", (0.1, 0.2, 0.4), "mosaic", mosaic(1.0, 0.0, 1.0, 0.0))
    yield one("gamma above 1", "exponent", (1.05, 1.2, 2.2), "not_linear", bent)
    yield one("gamma below 1", "exponent", (0.95, 0.8, 0.5), "not_linear", bent)
    yield one("bend towards the top", "of the peak", (0.05, 0.15, 0.3), "not_linear saturation", sagging)
    yield one("saturation", "of the peak", (0.8, 0.5, 0.25), "saturated saturation", saturated)
    yield one("few saturated values", "values", (12, 120, 1200), "saturated saturation", few_saturated)
    yield one("JPEG", "quality", (95, 75, 30), "compression", lambda r, s: compressed(r.clean(), s))
    yield one("background", "of the peak", (0.001, 0.005, 0.02), "background", lifted(1))
    yield one("dark frame too bright", "of the peak", (0.001, 0.005, 0.02), "background", lifted(-1))
    yield one("clipped at zero", "read noise", (0.0, 0.5, 1.0), "cut_off clipped background", clipped)
    yield one("glow of the amplifier", "of the peak", (0.003, 0.01, 0.03), "line_offsets background leak", glow)
    yield one("neighbours swapped", "pairs", (1, 3, 10), scan, swapped(False))
    yield one("far positions swapped", "pairs", (1, 3, 10), scan, swapped(True))
    yield one("rows swapped", "pairs", (1, 2, 3), scan, lines_swapped(0))
    yield one("columns swapped", "pairs", (1, 2, 3), scan, lines_swapped(1))
    yield one("scan to and fro read as raster", "rows", (1, 3, 7), scan, unwound)
    yield one("columns mirrored", "planes", (1, 2, 2), scan, mirrored(1))
    yield one("rows mirrored", "planes", (1, 2, 2), scan, mirrored(0))
    yield one("frames late", "frames", (1, 2, 5), scan + " frame_shift stage_axes backlash", late)
    yield one("repeated frames", "frames", (1, 5, 20), scan + " duplicates", repeated)
    yield one("blank frames", "frames", (1, 5, 20), "exposure missing", blank)
    yield one("stage moved during exposures", "frames", (40, 20, 12), scan + " jitter exposure", doubled)
    yield one("stage step", "of the step", (0.01, 0.03, 0.05), axes, sources(lambda r, s, y, x: (s * y, s * x)))
    yield one("step across", "of the step", (0.01, 0.03, 0.05), axes, sources(lambda r, s, y, x: (0 * y, s * x)))
    yield one("step down", "of the step", (0.02, 0.05, 0.08), axes, sources(lambda r, s, y, x: (s * y, 0 * y)))
    yield one("stage turned", "rad", (0.01, 0.03, 0.05), axes, sources(lambda r, s, y, x: (s * x, -s * y)))
    yield one("axes not square", "rad", (0.01, 0.03, 0.05), axes, sources(lambda r, s, y, x: (s * x, 0 * y)))
    yield one("drift across the scan", "px", (0.2, 0.6, 1.2), axes, sources(drift))
    yield one("play of the stage", "px", (0.1, 0.3, 0.6), "backlash", sources(play))
    yield one("jitter of the stage", "px rms", (0.06, 0.15, 0.3), "jitter", sources(scattered))
    yield one("periodic error of the screw", "px", (0.08, 0.2, 0.35), "jitter stage_axes", sources(screw))
    yield one("single sources displaced", "px", (0.3, 0.6, 0.9), "strangers jitter misplaced", sources(some))
    yield one("frames displaced across", "px", (0.25, 1, 3), "frame_shift", lambda r, s: halved(r.clean(), s, 1))
    yield one("frames displaced down", "px", (0.25, 1, 3), "frame_shift", lambda r, s: halved(r.clean(), s, 0))
    yield one("anchor wrong across", "px", (1, 2, 4), "frame_shift", whole(1))
    yield one("anchor wrong down", "px", (1, 2, 4), "frame_shift", whole(0))
    yield one("lamp that fades", "of the light", (0.04, 0.1, 0.3), "lamp", lit(lambda r, s: 1 - s * r.come()))
    yield one("lamp that rises", "of the light", (0.04, 0.1, 0.3), "lamp", lit(lambda r, s: 1 + s * r.come()))
    yield one("lamp that jumps", "of the light", (0.04, 0.1, 0.3), "lamp", lit(jump))
    yield one("lamp that flickers", "of the light", (0.03, 0.08, 0.2), "flicker", lit(flicker))
    yield one("one frame brighter", "times", (1.5, 3.0, 10.0), "exposure", lit(odd(1)))
    yield one("frames darker", "times", (0.7, 0.4, 0.1), "exposure missing", lit(odd(6)))
    yield one("automatic exposure", "exponent", (0.3, 0.6, 1.0), "auto_exposure", lit(equalised))
    yield one("focus that drifts", "of the depth", (0.015, 0.04, 0.08), "focus_drift", focus)
    yield one("focus that drifts in each plane", "virtual depth", (0.05, 0.12, 0.25), "focus_drift", warming)
    yield one("one plane at another depth", "of the depth", (0.01, 0.03, 0.1), "depth_label depth", deep(0))
    yield one("all planes too deep", "of the depth", (0.01, 0.03, 0.1), "depth_label depth", deep(0, 1))
    yield one("planes swapped", "of the rows", (0.2, 0.5, 1.0), "depth_label strangers focus_drift", swapped_planes)
    yield one("ghost", "of the light", (0.01, 0.03, 0.1), "ghost", ghost())
    yield one("ghost mirrored", "of the light", (0.01, 0.03, 0.1), "ghost", ghost(3))
    yield one("ghost turned", "of the light", (0.01, 0.03, 0.1), "ghost", ghost(3, 4))
    yield one("lens type dim", "of the light", (0.08, 0.2, 0.5), "type_light", dim_type)
    yield one("lens type out of focus", "of the focal length", (0.02, 0.05, 0.15), "type_focus", blurred_type)
    yield one("blade stuck", "of the radius", (0.15, 0.3, 0.6), "pupil", shadow(straight=True))
    yield one("vignetting to one side", "of the light", (0.1, 0.3, 0.7), "pupil", shadow(straight=False))


FAULTS: tuple[Injected, ...] = tuple(_faults())
"""All faults."""
