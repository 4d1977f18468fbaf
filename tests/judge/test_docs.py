"""The fault shown in the documentation is complete, and is found where it is put in."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.judge import Fault
from lfcal.judge.faults._series import scan_order
from tests.distribution import DOCS, names_of
from tests.judge.common import clean, evidence_of, light, noisy, plan


def documented() -> Fault:
    fault = names_of("extending.md", "A fault")["FRINGES"]
    assert isinstance(fault, Fault)
    return fault


@pytest.mark.usefixtures("all_patterns")
def test_it_is_found_and_taken_out() -> None:
    nx = plan().period[1]
    fringes = 1 + 0.05 * np.cos(2 * np.pi * 4 * np.arange(nx) / nx + 1)
    evidence = evidence_of(noisy((light() * fringes[:, None, None]).astype(np.float32)))
    (found,) = documented().found(evidence)
    assert found.detail.endswith("4 times over the period") and found.picture is not None
    assert found.repair is not None
    without = evidence.with_data(found.repair(evidence.index, evidence.data), evidence.valid)
    order = scan_order(evidence.index)
    before, after = (part.column("gain")[0][order] for part in (evidence, without))
    assert np.ptp(after) < np.ptp(before) / 2
    assert not list(documented().found(without))


def test_a_clean_recording_has_none() -> None:
    assert not list(documented().found(evidence_of(clean())))


def test_the_documentation_leads_to_it() -> None:
    for page in (DOCS.parent / "README.md", DOCS / "quality.md"):
        assert "extending.md" in page.read_text(encoding="utf-8")
