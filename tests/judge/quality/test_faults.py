import numpy as np
import pytest

from lfcal.judge.quality import inspect

from .faults import CLEAN, FAULTS
from .scenes import Scene, hexagonal, single, square

SQUARE = ("two rows swapped", "axes swapped", "stage step 10 % too large", "planes in the wrong order", "a hot pixel")


def named(scene: Scene, name: str) -> list[str]:
    """Return the bad metrics of a fault, costliest first."""
    return [m.key for m in inspect(FAULTS[name].make(scene), workers=1).alarms]


def test_there_are_faults_enough():
    assert len(FAULTS) >= 24


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", [hexagonal, square, single], ids=lambda s: s.__name__)
@pytest.mark.parametrize("kind", CLEAN)
def test_nothing_clean_raises_an_alarm(scene, kind):
    report = inspect(CLEAN[kind](scene()), workers=1)
    assert report.merit == "good", [(m.key, m.text) for m in report.metrics if m.merit in ("bad", "fair")]
    assert report.redo() == []


@pytest.mark.few(2)
@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_named_by_its_metric(name):
    alarms = named(hexagonal(), name)
    assert set(alarms[:2]) & set(FAULTS[name].names), alarms


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("name", SQUARE)
def test_a_square_array_is_judged_as_well(name):
    alarms = named(square(), name)
    assert set(alarms[:2]) & set(FAULTS[name].names), alarms


def test_single_frames_are_named_by_position():
    report = inspect(FAULTS["a missing frame"].make(hexagonal()))
    assert report.redo() == [((1, 4, 7), "missing frames")]
    assert np.isnan(report["missing"].map).sum() == 0


def test_the_order_of_the_scan_is_said_in_words():
    report = inspect(FAULTS["direction reversed"].make(hexagonal()))
    assert "backwards along x" in report["scan_order"].detail
