"""The verdict that a project keeps of its H."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lfcal.base import Finding, Judgement
from lfcal_gui.models import PageState, ProjectState, kept_verdict, page_states, stamp_of, verdict_of, with_verdict
from lfcal_gui.models.verdict import Verdict

LOST = Finding(kind="misplaced", what="misplaced frames", merit="bad", repeat=5)
DARK = Finding(kind="background", what="background", merit="bad")
REDO = ((5, 3, 7), (5, 11, 25), (5, 12, 4), (5, 16, 18), (4, 6, 30))


def test_a_verdict_is_kept_as_long_as_the_file_is_the_same(tmp_path: Path) -> None:
    """The rail said "ready" of an H that was judged."""
    file = tmp_path / "H.h5"
    file.write_text("H")
    project = ProjectState(psf=str(file))
    assert kept_verdict(project) is None and page_states(project)["h"] is PageState.DONE
    stamp = stamp_of(str(file))
    assert stamp is not None
    for verdict, state in (
        (Verdict("good"), PageState.DONE),
        (Verdict("bad", "x", 1, 0.01, redo=((5, 3, 7),)), PageState.ATTENTION),
    ):
        project = replace(project, settings=with_verdict(project, stamp, verdict))
        again = ProjectState.from_json(project.to_json())
        assert kept_verdict(again) == verdict and page_states(again)["h"] is state
    (kept,) = project.settings["verdicts"]
    for damaged in (None, [], 3, [3], [{**kept, "bad": "many"}], [{"stamp": list(stamp[1:])}]):
        assert kept_verdict(replace(project, settings={"verdicts": damaged})) is None
    file.write_text("another H")
    assert kept_verdict(project) is None


def test_verdicts_on_other_h_stay(tmp_path: Path) -> None:
    """That on the first H was gone once a second one was judged."""
    project = ProjectState()
    for name, merit in (("a", "good"), ("b", "bad"), ("a", "fair")):
        file = tmp_path / f"{name}.h5"
        if not file.exists():
            file.write_text(f"H {'of ' * (name == 'b')}{name}")
        stamp = stamp_of(str(file))
        assert stamp is not None
        project = replace(project, settings=with_verdict(project, stamp, Verdict(merit)))
    assert [kept_verdict(project, str(tmp_path / f"{name}.h5")) for name in "ab"] == [Verdict("fair"), Verdict("bad")]
    assert len(project.settings["verdicts"]) == 2 and kept_verdict(project) is None


def test_a_verdict_says_what_is_left_once_its_positions_are_recorded_again() -> None:
    few = verdict_of(Judgement("H", (LOST,), "good by 30 checks"), REDO, 627, 39)
    assert few.few and (few.bad, few.rest, few.failed, few.checks) == (5, "good", 1, 39)
    assert few.share == 4 / 627 and few.sentence.startswith("This H should not be used")
    assert not verdict_of(Judgement("H", (LOST,), ""), REDO, 40, 39).few, "a tenth of a plane"
    both = verdict_of(Judgement.of("H", (LOST, DARK), ""), REDO, 627, 39)
    assert both.rest == "bad" and not both.few
    doubt = Finding(kind="unfinished", what="comparison", merit="unknown")
    assert verdict_of(Judgement.of("H", (LOST, doubt), ""), REDO, 627).rest == "unknown"


def test_a_remedy_is_kept_where_a_correction_of_frames_is_one() -> None:
    assert verdict_of(Judgement("H", (DARK,), "")).remedy == "dark"
    assert verdict_of(Judgement("H", (LOST,), "")).remedy == ""
    good = verdict_of(Judgement("H", (), "good by 30 checks"))
    assert good.usable and not good.few and good == Verdict("good", "This H is good by 30 checks.")
