"""Files of units are joined while later units are under way; nothing has the name of the whole before all are done."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfcal.base.errors import InputError
from lfcal.base.files import replace_whole
from lfcal.base.progress import Clock, Work, drain
from lfcal.work import RunChoice, iter_made, parts_folder
from lfcal.work._following import Following
from lfcal.work.runs import was_joining
from tests.work.tasks import unit


class Joining:
    """Joins texts; notes what it took, and adds to ``marks`` with each."""

    def __init__(self, out: Path, marks: Path | None = None) -> None:
        self.out, self.marks, self.taken = out, marks, list[str]()
        self.noted = list[bool]()

    def __call__(self, files: tuple[Path, ...]) -> Work[None]:
        clock = Clock("joining", len(files))
        with replace_whole(self.out) as part:
            yield clock.at(0)
            for k, file in enumerate(files):
                self.taken.append(file.read_text())
                self.noted.append(was_joining(self.out))
                if self.marks is not None:
                    with self.marks.open("a") as marks:
                        marks.write("x")
                yield clock.at(k + 1)
            part.write_text("".join(self.taken))


@pytest.mark.parametrize("in_order", [False, True])
@pytest.mark.parametrize("run", [RunChoice("threads", 1), RunChoice("processes", 2)])
def test_the_same_whole(tmp_path: Path, run: RunChoice, in_order: bool) -> None:
    join = Joining(tmp_path / "out")
    units = [unit(f"plane {k}", text=f"{k}") for k in range(5)]
    records = []
    drain(iter_made(units, join.out, run, join, title="", in_order=in_order), records.append)
    assert join.out.read_text() == "01234" and join.taken == list("01234")
    assert records[-1].stage == "joining" and records[-1].fraction == 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_it_goes_on_while_units_are_under_way(tmp_path: Path) -> None:
    """The last unit ends when the first two were joined; until then nobody says that the whole is written."""
    join = Joining(tmp_path / "out", tmp_path / "marks")
    last = unit("c", "meet", marks=str(join.marks), count=3)
    units = [unit("a", text="a"), unit("b", text="b"), last]
    drain(iter_made(units, join.out, RunChoice("threads", 1), join, title="", in_order=True))
    assert join.out.read_text() == "ab0"
    assert join.noted[:2] == [False, False]


def test_what_fails_leaves_only_the_units(tmp_path: Path) -> None:
    join = Joining(tmp_path / "out")
    units = [unit("a", text="a"), unit("b", "refuse"), unit("c")]
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_made(units, join.out, RunChoice("threads", 1), join, title="", in_order=True))
    assert [path.name for path in tmp_path.iterdir()] == ["out.parts"]
    assert not was_joining(join.out)
    units[1] = unit("b", text="b")
    again = RunChoice("threads", 1, begun="resume")
    drain(iter_made(units, join.out, again, join, title="", in_order=True))
    assert join.out.read_text()[-3:] == "abx" and not parts_folder(join.out).exists()


def test_closing_leaves_only_the_units(tmp_path: Path) -> None:
    join = Joining(tmp_path / "out")
    units = [unit("a", text="a"), unit("b", "endless", begun=str(tmp_path / "begun"))]
    work = iter_made(units, join.out, RunChoice("threads", 1), join, title="", in_order=True)
    for _ in work:
        if join.taken:
            break
    work.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["begun", "out.parts"]


def test_no_step_is_taken_for_a_file_that_is_not_there(tmp_path: Path) -> None:
    files = [tmp_path / name for name in "abc"]
    join = Joining(tmp_path / "out")
    following = Following(join)
    for there, taken in ((0, 0), (0, 0), (1, 1), (1, 1)):
        for file in files[:there]:
            file.write_text(file.name)
        following.advance(files, there)
        assert len(join.taken) == taken
    for file in files:
        file.write_text(file.name)
    for taken in (2, 3, 3, 3):
        following.advance(files, 3)
        assert len(join.taken) == taken
    assert not join.out.exists()
    assert [record.done for record in following.rest(files)] == [3]
    assert join.out.read_text() == "abc"
