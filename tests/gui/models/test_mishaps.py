from __future__ import annotations

from lfcal_gui.models.mishaps import Mishap, Mishaps, safe_words


def raised(kind: type[Exception], text: str) -> Mishap:
    try:
        raise kind(text)
    except kind as error:
        return Mishap.of(error)


def test_each_kind_counts_for_itself() -> None:
    found = Mishaps()
    assert found.add(raised(KeyError, "a"))[1]
    again, first = found.add(raised(KeyError, "b"))
    assert not first and again.count == 2 and "(2 times)" in again.title()
    assert found.add(raised(ValueError, "a"))[1]
    assert [m.count for m in found.all()] == [2, 1]


def test_words_are_one_short_line() -> None:
    mishap = raised(RuntimeError, "first\nsecond\t" + "x" * 5000)
    assert mishap.words.startswith("RuntimeError: first second x") and len(mishap.words) <= 500


def test_what_is_safe() -> None:
    def words(**changes: object) -> str:
        given = {"unsaved": True, "project": "", "copy": "/c.lfcal", "jobs": (), "recording": False}
        return " ".join(safe_words(**{**given, **changes}))  # type: ignore[arg-type]

    assert "/c.lfcal" in words()
    assert "could not be copied" in words(copy="") and "under a new name" in words(copy="")
    assert "saved in /p.lfcal" in words(unsaved=False, project="/p.lfcal", copy="")
    assert "no unsaved changes" in words(unsaved=False, copy="")
    assert "every position counted as done is on the disk" in words(recording=True, jobs=("Record a",))
    assert "Record a" in words(recording=True, jobs=("Record a",))
