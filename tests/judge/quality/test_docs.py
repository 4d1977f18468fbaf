"""The metric shown in the documentation is complete, is found as another package's, and is shown."""

from __future__ import annotations

from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lfcal.judge.quality import METRICS, MetricSpec, inspect
from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Run
from tests.distribution import names_of
from tests.judge.plain_report import undrawn


@pytest.fixture
def declare(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Pretend that other packages declare these metrics."""
    real = metadata.entry_points

    def pretend(**values: Any) -> None:
        points = [SimpleNamespace(name=name, load=lambda value=value: value) for name, value in values.items()]
        found = lambda **wanted: points if wanted.get("group") == "lfcal.metrics" else real(**wanted)  # noqa: E731
        monkeypatch.setattr(metadata, "entry_points", found)
        monkeypatch.setattr(METRICS, "_parts", None)
        monkeypatch.setattr(METRICS, "_failures", {})

    return pretend


def documented() -> MetricSpec:
    spec = names_of("extending.md", "A check of H")["ROW_OFFSETS"]
    assert isinstance(spec, MetricSpec)
    return spec


def recorded(offset: float) -> PSFMatrix:
    """Return spots on a sensor whose rows are off by ``offset`` rms, noise 1, peak about 1000."""
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:31, :31]
    level = offset * rng.standard_normal(31 + 5)
    values = rng.normal(0, 1, (1, 6, 7, 31, 31))
    for y, x in np.ndindex(6, 7):
        values[0, y, x] += 1000 * np.exp(-((rows - 15) ** 2 + (columns - 15 - 0.1 * x) ** 2) / 20)
        values[0, y, x] += level[y : y + 31, None]
    return PSFMatrix(values.astype(np.float32), depths=[-20e3])


def test_the_documented_metric_measures_what_it_says(declare: Callable[..., None]) -> None:
    declare(row_offsets=documented())
    assert "row_offsets" in METRICS
    clean, off = inspect(recorded(0.0))["row_offsets"], inspect(recorded(3.0))["row_offsets"]
    assert clean.merit == "good"
    assert off.merit == "bad" and off.value == pytest.approx(0.3, rel=0.25)
    assert off.cost == pytest.approx(0.5 * off.value / 0.2)


def test_the_documented_metric_is_shown(
    declare: Callable[..., None],
    lfcal: Callable[..., Run],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    undrawn(monkeypatch)
    declare(row_offsets=documented())
    save(recorded(5.0), tmp_path / "H.h5")
    run = lfcal("inspect", tmp_path / "H.h5", "--report", tmp_path / "out")
    assert run.code == 0, run.err
    assert "Row offsets" in run.out and "should not be used as it is: row offsets" in run.out
    assert "Scatter of the dark level" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")


def test_others_cannot_hide_or_break_what_is_there(
    declare: Callable[..., None],
    lfcal: Callable[..., Run],
    tmp_path: Path,
) -> None:
    own = METRICS.get("snr")
    false = MetricSpec(
        key="snr", title="false", meaning="m.", advice="a.", limits=own.limits, cost=own.cost, of_plane=own.of_plane
    )
    declare(false=false, broken="no metric")
    assert METRICS.get("snr") is own
    assert list(METRICS.failures()) == ["broken"]
    save(recorded(0.0), tmp_path / "H.h5")
    run = lfcal("inspect", tmp_path / "H.h5", "--json")
    assert run.code == 0 and isinstance(run.json, dict)
    assert run.err.startswith("lfcal: note: left out: check of H broken") and len(run.err.splitlines()) == 1
