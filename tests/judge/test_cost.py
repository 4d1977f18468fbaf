"""What a fault costs on a patch of H is what it costs a large reconstruction; no fault costs nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks._fault_costs import TrueCost
from benchmarks._fault_list import FAULTS
from benchmarks._fault_recordings import CAMERAS, Recording
from lfcal.base.progress import drain
from lfcal.judge import Evidence, FoundFault, iter_inspection, iter_search
from lfcal.judge._cost import FEWEST, Costs, iter_costs
from lfcal.judge.quality import inspect
from tests.judge.common import (
    PEAK,
    Values,
    added,
    clean,
    compressed,
    evidence_of,
    light,
    matrix,
    noisy,
    plan,
    scaled,
    sensor,
    truth,
)
from tests.judge.test_inspection import inspected
from tests.judge.test_stage_faults import displaced, grid

rows = (np.arange(plan().period[0]) % 2)[:, None]


def line(base: float, value: float, axis: int = 1) -> Values:
    image = sensor(base)
    image[(25, slice(None)) if axis == 0 else (slice(None), 25)] = value
    return image


def mosaic() -> Values:
    image = sensor(1.0)
    image[::2, ::2], image[1::2, 1::2] = 0.6, 0.5
    return image


def spot() -> Values:
    image = sensor(0.0)
    image[20, 33] = 0.3 * PEAK
    return image


def faded(by: float) -> Values:
    ny, nx = plan().period
    come = (np.arange(ny * nx).reshape(ny, nx) / (ny * nx))[None, :, :, None, None]
    return noisy((light() * (1 - by * come)).astype(np.float32))


def moved_halfway() -> Values:
    values = clean()
    values[1] = np.roll(values[1], 1, axis=3)
    return values


def bent(power: float) -> Values:
    values = clean()
    return (np.sign(values) * PEAK * (np.abs(values) / PEAK) ** power).astype(np.float32)


def offsets() -> Values:
    return sensor(0.0) + np.random.default_rng(1).normal(0, 6, (len(sensor(0)), 1)).astype(np.float32)


y, x = grid()
KINDS: dict[str, Callable[[], Values]] = {
    "dead_line": lambda: noisy(scaled(light(), line(1.0, 0.0))),
    "hot_line": lambda: added(clean(), line(0.0, 0.02 * PEAK)),
    "line_offsets": lambda: added(clean(), offsets()),
    "bad_pixels": lambda: added(clean(), spot()),
    "mosaic": lambda: noisy(scaled(light(), mosaic())),
    "not_linear": lambda: bent(1.2),
    "compression": lambda: compressed(clean(), 75),
    "lamp": lambda: faded(0.2),
    "depth_label": lambda: clean()[::-1].copy(),
    "frame_shift": moved_halfway,
    "stage_axes": lambda: displaced(0.03 * y, 0.03 * x, everywhere=True),
    "backlash": lambda: displaced(0 * y, np.where(rows == 1, 0.25, -0.25) + 0 * y, everywhere=True),
    "jitter": lambda: displaced(*np.random.default_rng(5).normal(0, 0.1, (2, *plan().period)), everywhere=True),
}


@cache
def in_faded() -> tuple[FoundFault, Evidence]:
    """Return what is found where the lamp fades, and the evidence without it."""
    (one,), cleaned = drain(iter_search(evidence_of(faded(0.2))))
    return one, cleaned


@cache
def true_cost(name: str) -> float:
    """Return what a fault costs in a large reconstruction."""
    return truth().cost(KINDS[name]())


def costs_of(values: Values) -> tuple[tuple[FoundFault, ...], Costs]:
    found, cleaned = drain(iter_search(evidence_of(values)))
    return found, drain(iter_costs(cleaned, found, None))


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_costs_are_those_of_a_large_reconstruction(name: str) -> None:
    values = KINDS[name]()
    found, costs = costs_of(values)
    told = {one.name: cost for one, cost in zip(found, costs.costs, strict=True)}[name]
    true = true_cost(name)
    assert told is not None and true > 0.01 and true / 2 < told < 2 * true, (told, true)
    assert costs.clean is not None and costs.as_it_is is not None
    assert truth().clean / 2 < costs.clean or name == "compression", "of which noise is none"
    assert costs.as_it_is - costs.clean > 0.5 * true


@pytest.mark.long
@pytest.mark.parametrize(
    ("camera", "name", "strength"),
    [
        ("bench", "glow of the amplifier", 0.01),  # told .43 of it when rows and columns were two faults
        ("lfm_60x12", "offsets of rows", 5),  # told .28 of it when the cutouts of 131 px were cut to 95
    ],
)
def test_offsets_cost_what_they_cost_on_all_of_the_cutout(camera: str, name: str, strength: float) -> None:
    own = Recording(CAMERAS[camera]())
    values = next(one for one in FAULTS if one.name == name).put_in(own, strength)
    found = drain(iter_inspection(own.matrix(values), inspect(own.matrix(values), workers=1), patterns=60)).faults
    told = next(one.cost for one in found if one.name == "line_offsets")
    true = TrueCost(own.light(), own.clean()).cost(values)
    assert told is not None and true / 1.9 < told < 1.9 * true, (told, true)


@pytest.mark.long
def test_two_faults_have_each_its_cost() -> None:
    found, costs = costs_of(scaled(faded(0.2), line(1.0, 0.0)))
    told = dict(zip((one.name for one in found), costs.costs, strict=True))
    alone, fading = map(true_cost, ("dead_line", "lamp"))
    assert told["dead_line"] == pytest.approx(alone, rel=0.5) and told["lamp"] == pytest.approx(fading, rel=0.5)
    assert costs.clean is not None and costs.as_it_is is not None
    assert truth().clean / 2 < costs.clean and costs.as_it_is - costs.clean > 0.5 * max(alone, fading)


def test_no_finding_costs_nothing_and_one_that_nothing_is_known_of_has_no_cost() -> None:
    evidence = evidence_of(clean())
    assert drain(iter_costs(evidence, (), None)) == Costs(None, None, ())
    one, cleaned = in_faded()
    costs = drain(iter_costs(cleaned, (replace(one, put_in=None),), FEWEST))
    assert costs.costs == (None,) and costs.clean is not None


@pytest.mark.long
def test_costs_are_the_same_each_time() -> None:
    one, cleaned = in_faded()
    assert drain(iter_costs(cleaned, (one,), FEWEST)) == drain(iter_costs(cleaned, (one,), FEWEST))


@pytest.mark.long
def test_a_part_of_the_period_tells_about_the_same() -> None:
    (one,), cleaned = drain(iter_search(evidence_of(noisy(scaled(light(), line(1.0, 0.7))))))
    (whole,), (part,) = (drain(iter_costs(cleaned, (one,), many)).costs for many in (None, FEWEST))
    assert whole is not None and part is not None and whole / 3 < part < 3 * whole


@pytest.mark.long
def test_frames_that_were_not_looked_at_cost_what_those_do_that_were() -> None:
    """Three rows in two planes run the other way: 192 patterns, of which 48 are compared for being odd."""
    values = clean()
    values[:, 1:7:2] = values[:, 1:7:2, ::-1].copy()
    one = next(one for one in inspected(matrix(values)).faults if one.name == "strangers")
    true = truth().cost(values)
    assert one.extent == pytest.approx(192 / (2 * 19 * 33), rel=0.3)
    assert one.cost is not None and true / 1.5 < one.cost < 1.5 * true
