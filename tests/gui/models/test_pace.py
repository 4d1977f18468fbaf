"""Forecasts are corrected by the real runs of this machine, and nothing is shown where nothing was measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfcal.psf import Facts, Origin, PSFMatrix, save
from lfcal_gui.models.gathering import sitting_of
from lfcal_gui.models.pace import KEPT, Paces
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.models.verdict import Verdict, with_verdict


def test_the_median_of_the_last_runs_counts() -> None:
    paces = Paces()
    assert paces.corrected({"make_s": 2.0, "compute_s": None}) == {"make_s": 2.0, "compute_s": None}
    for seconds in (100.0, 100.0, 3.0, 3.0, 0.1, 3.0, 3.0):
        paces.take("make", 1.0, seconds)
    assert len(paces.runs["make"]) == KEPT and paces.corrected({"make_s": 2.0})["make_s"] == 6.0
    assert paces.corrected({"compute_s": 2.0})["compute_s"] == 2.0, "another kind of job"
    paces.take("make", 0.0, 5.0)
    assert len(paces.runs["make"]) == KEPT


@given(st.dictionaries(st.sampled_from(("make", "compute")), st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=KEPT)))
def test_it_is_kept_between_starts(runs: dict[str, list[float]]) -> None:
    again = Paces.of(Paces(runs).texts())
    assert again.runs.keys() == runs.keys()
    assert all(again.runs[kind] == pytest.approx(runs[kind], rel=1e-3) for kind in runs)


@pytest.mark.parametrize("text", ["", "make", "make x", "other 1", "make nan", "make -1", "make 0", "make inf"])
def test_what_is_no_such_text_is_left_out(text: str) -> None:
    assert Paces.of([text] if text else []).runs == {}


def test_a_sitting_has_corrected_times() -> None:
    told = {"frames": {"make_s": 2.0}, "simulate": {"compute_s": 1.0, "error": 0.01}}
    plain = sitting_of(ProjectState(), told, ())
    assert (plain.make_s, plain.compute_s, plain.error) == (2.0, 1.0, 0.01)
    found = sitting_of(ProjectState(), told, (), paces=Paces({"make": [1.5], "compute": [0.5]}))
    assert (found.make_s, found.compute_s, found.error) == (3.0, 0.5, 0.01)
    assert sitting_of(ProjectState(), {}, ()).make_s is None


def test_positions_that_a_model_filled_are_not_to_be_left_out_again(tmp_path: Path) -> None:
    origin = np.zeros((1, 4, 4), np.uint8)
    origin[0, 1, 2] = Origin.MODEL
    recorded = np.ones((1, 4, 4), int)
    recorded[0, 1, 2] = recorded[0, 3, 3] = 0
    facts = Facts.of((1, 4, 4), (5, 5), recorded=recorded, origin=origin)
    matrix = PSFMatrix(np.ones((1, 4, 4, 5, 5)), facts=facts)
    save(matrix, path := tmp_path / "H.h5")
    project = ProjectState(psf=str(path))
    stamp = stamp_of(str(path))
    assert stamp is not None
    verdict = Verdict("good", "", bad=2, share=0.01, failed=1, checks=9, redo=((0, 1, 2), (0, 3, 3)))
    project = replace(project, settings=with_verdict(project, stamp, verdict))
    for one in (matrix, matrix.T):
        found = sitting_of(project, {}, (), matrix=one)
        assert (found.filled, found.bad, replace(found, rig=True).bad) == (1, 1, 2)
    assert sitting_of(project, {}, ()).filled == 0
