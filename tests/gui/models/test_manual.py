from __future__ import annotations

import pytest

from lfcal.judge.fault import FAULTS
from lfcal_gui.models.manual import ATLAS, manual_folder, section_of


@pytest.mark.parametrize("name", FAULTS.names())
def test_every_fault_has_its_section_in_the_atlas(name: str) -> None:
    text = (manual_folder() / ATLAS).read_text(encoding="utf-8")
    section = section_of(text, name)
    assert section.count("## ") == 1 and f"`{name}`." in section and "**What to do:**" in section


def test_what_has_no_section_shows_the_whole_page() -> None:
    assert section_of("# Page\n\n## One\n\n`one`. Words.\n", "two").startswith("# Page")
