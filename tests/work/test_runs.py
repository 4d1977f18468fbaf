"""Runs: what is done is left out, what is lost is tried again, and nothing half-written stays."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.base.errors import InputError, LfcalError, StorageError
from lfcal.base.files import only_writer, replace_whole
from lfcal.base.progress import Clock, Progress, Work, drain
from lfcal.work import RunChoice, Unit, iter_made, iter_run, parts_folder, read_run
from lfcal.work.executors.base import Event, EventKind
from lfcal.work.executors.processes import Processes, TaskFailed, WorkerLost
from lfcal.work.executors.threads import Threads
from lfcal.work.journal import JOURNAL, SETTLED, Journal, read_notes
from lfcal.work.runs import Following, check_begun, discard, was_joining
from lfcal.work.unit import numbered, worker_number
from tests.work.tasks import unit


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "H.h5.parts"


def texts(parts: tuple[Path, ...]) -> list[str]:
    return [part.read_text() for part in parts]


def done(seen: Path) -> int:
    return len(seen.read_text().splitlines()) if seen.exists() else 0


def test_units_in_order_and_progress_over_all(folder: Path) -> None:
    records = []
    units = [unit(f"plane {k}", text=f"{k}") for k in range(5)]
    parts = drain(iter_run(units, folder, Threads(2)), records.append)
    assert texts(parts) == list("01234")
    fractions = [record.fraction for record in records]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert records[-1].note == "5 of 5 done"


def test_what_is_done_is_not_done_again(folder: Path, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    units = [unit(f"plane {k}", seen=str(seen)) for k in range(3)]
    first = drain(iter_run(units, folder, Threads(1)))
    first[1].unlink()
    assert drain(iter_run(units, folder, Threads(1))) == first
    assert done(seen) == 4


def test_other_settings_begin_anew_and_sweep_what_was(folder: Path) -> None:
    drain(iter_run([unit("a", text="old"), unit("b", text="b")], folder, Threads(1)))
    parts = drain(iter_run([unit("a", text="new"), unit("b", text="b")], folder, Threads(1)))
    assert texts(parts) == ["new", "b"]
    assert {path.name for path in folder.iterdir()} == {JOURNAL, *(part.name for part in parts)}


def test_another_run_in_the_same_folder_is_refused(folder: Path) -> None:
    folder.mkdir()
    with only_writer(folder), pytest.raises(StorageError, match="another program is writing"):
        drain(iter_run([unit("a")], folder, Threads(1)))


def test_a_refusal_ends_the_run_and_keeps_the_rest(folder: Path) -> None:
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_run([unit("a"), unit("b", "refuse"), unit("c")], folder, Threads(1)))
    state = read_run(folder)
    assert [u.state for u in state.units] == ["done", "failed", "waiting"]
    assert "open the shutter" in state.units[1].reason
    assert not state.running


def test_a_clock_that_is_set_back_makes_no_time_negative(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour back while the first unit is done, and again while the second is under way."""
    folder.mkdir()
    clock = iter([10_000.0, 10_001.0, 6_401.0, 6_402.0])
    monkeypatch.setattr("lfcal.work.journal.time.time", lambda: next(clock))
    with Journal.open(folder) as journal:
        journal.begin("two", ["a", "b"], "threads", 1, "")
        journal.note("started", unit="a")
        journal.note("done", unit="a")
        journal.note("started", unit="b")
    state = read_run(folder, now=2_802.0)
    assert [unit.seconds for unit in state.units] == [0.0, 0.0] and state.running
    assert state.eta_seconds is not None and state.eta_seconds >= 0


def test_a_task_that_writes_nothing_is_a_fault(folder: Path) -> None:
    with pytest.raises(InputError, match="expected the file"):
        drain(iter_run([unit("a", "forget")], folder, Threads(1)))


def test_two_units_of_one_name(folder: Path) -> None:
    with pytest.raises(InputError, match="a name for each"):
        drain(iter_run([unit("a"), unit("a", text="y")], folder, Threads(1)))


def test_closing_stops_and_leaves_nothing_half_written(folder: Path, tmp_path: Path) -> None:
    work = iter_run([unit("a"), unit("b", "endless", begun=str(tmp_path / "begun"))], folder, Threads(1))
    for _ in work:
        if (tmp_path / "begun").exists():
            break
    work.close()
    assert [path.suffix for path in folder.iterdir() if path.name != JOURNAL] == [".txt"]
    assert [u.state for u in read_run(folder).units] == ["done", "waiting"]


def test_a_run_that_was_killed_before_it_began_stops_nobody(folder: Path) -> None:
    folder.mkdir()
    (folder / JOURNAL).touch()
    check_begun(folder, resume=False)


@pytest.mark.parametrize(("joined", "room"), [(False, 4), (True, 9)])
def test_a_disk_that_is_too_small_is_told_after_the_first_unit(
    folder: Path, monkeypatch: pytest.MonkeyPatch, joined: bool, room: int
) -> None:
    """Five units of 3 MB, or ten with what is joined of them: one is there, so the others need four, or nine."""
    size, beside = 3 << 20, (1 << 20) + (1 << 18)  # what HDF5 takes beside the data

    def full(free: int) -> None:
        usage = shutil.disk_usage(folder)
        monkeypatch.setattr("lfcal.base.files.shutil.disk_usage", lambda path: usage._replace(free=free))

    units = [unit(f"plane {k}", text=f"{k}" * size) for k in range(5)]
    folder.mkdir()
    full((room - 1) * size + beside)
    with pytest.raises(StorageError, match=r"disk space for the remaining files .*: expected at least .*, got "):
        drain(iter_run(units, folder, Threads(1), joined=joined))
    assert read_run(folder).count("done") == 1
    full(room * size + beside)
    assert len(drain(iter_run(units, folder, Threads(1), joined=joined))) == 5


# -- processes -------------------------------------------------------------------------------------------


def test_processes_replace_those_that_are_killed(folder: Path, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    units = [unit(f"plane {k}", text=f"{k}", seen=str(seen)) for k in range(4)]
    units[1] = unit("plane 1", "die", text="1", times=2, marks=str(tmp_path / "marks"), seen=str(seen))
    parts = drain(iter_run(units, folder, Processes(2)))
    assert texts(parts) == list("0123")
    lines = [line.split() for line in seen.read_text().splitlines()]
    assert len(lines) == 4
    assert {(threads, told) for _, threads, told in lines} == {("1", "1")}
    state = read_run(folder).units[1]
    assert (state.state, state.attempts) == ("done", 3)
    assert {path.name for path in folder.iterdir()} == {JOURNAL, *(part.name for part in parts)}


def test_a_unit_whose_worker_always_ends_is_given_up(folder: Path, tmp_path: Path) -> None:
    units = [unit("plane 0", "die", times=9, marks=str(tmp_path / "marks"))]
    with pytest.raises(WorkerLost, match=r"plane 0: its process ended \(signal 9\) in each of 2 attempts"):
        drain(iter_run(units, folder, Processes(1), attempts=2))
    assert read_run(folder).units[0].state == "failed"
    assert [path.name for path in folder.iterdir()] == [JOURNAL]


def test_each_process_has_a_number_and_hands_it_on(folder: Path, tmp_path: Path) -> None:
    units = [unit("a", "count"), unit("b", "count")]
    assert [part.read_text() for part in drain(iter_run(units, folder, Processes(2)))] == ["0", "1"]
    ends = unit("c", "die", times=1, marks=str(tmp_path / "marks"))
    parts = drain(iter_run([ends, unit("d", "count"), unit("e", "count")], folder, Processes(1)))
    assert [part.read_text() for part in parts[1:]] == ["0", "0"]
    assert drain(iter_run([unit("f", "count")], folder, Threads(1)))[0].read_text() == "0"


def test_names_give_numbers_that_stay() -> None:
    with numbered("tcp://10.0.0.1:4000"):
        first = worker_number()
    with numbered("tcp://10.0.0.1:4000"), numbered(2):
        assert worker_number() == 2
    with numbered("tcp://10.0.0.1:4000"):
        assert worker_number() == first > 0
    assert worker_number() == 0


def test_faults_in_processes_are_told(folder: Path) -> None:
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_run([unit("a", "refuse")], folder, Processes(1)))
    with pytest.raises(TaskFailed, match=r"ZeroDivisionError at tasks\.py:\d+: one by nothing"):
        drain(iter_run([unit("a", "stumble")], folder, Processes(1)))


def test_a_file_that_another_program_holds_is_tried_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal.work.runs.PAUSE", 0.01)
    parts = drain(iter_run([unit("a", "busy_file", marks=str(tmp_path / "marks"))], folder, Processes(1)))
    assert texts(parts) == ["x"]


def test_closing_ends_the_processes(folder: Path, tmp_path: Path) -> None:
    from lfcal.base.system import is_alive

    begun = tmp_path / "begun"
    work = iter_run([unit("b", "endless", begun=str(begun))], folder, Processes(1))
    for _ in work:
        if begun.exists() and begun.read_text():
            break
    work.close()
    assert not is_alive(int(begun.read_text()))
    assert [path.name for path in folder.iterdir()] == [JOURNAL]
    parts = drain(iter_run([unit("b", text="whole")], folder, Threads(1)))
    assert texts(parts) == ["whole"]


@pytest.mark.parametrize("harm", ["", "changed"])
def test_what_a_worker_wrote_is_looked_through_by_nobody(
    folder: Path, monkeypatch: pytest.MonkeyPatch, harm: str
) -> None:
    """Unless it is something else by then: H of a unit is joined without another process that reads it first."""

    class Harming(Threads):
        def events(self) -> list[Event]:
            found = super().events()
            for event in found:
                if event.kind is EventKind.DONE and harm:
                    Path(event.job.out).write_text(harm)
            return found

    trusted: list[Path] = []
    monkeypatch.setattr("lfcal.work.runs.trust", trusted.append)
    units = [replace(unit("a"), suffix=".h5"), unit("b")]
    parts = drain(iter_run(units, folder, Harming(1)))
    assert trusted == ([] if harm else [parts[0]])


# -- what an earlier run left ------------------------------------------------------------------------------
def test_what_an_earlier_run_left_is_asked_about(folder: Path) -> None:
    check_begun(folder, resume=False)
    with pytest.raises(InputError):
        drain(iter_run([unit("a"), unit("b", "refuse")], folder, Threads(1)))
    with pytest.raises(
        InputError, match=r"left 1 of 2 units finished; continue from them \(--resume\), or start again \(--force\)"
    ):
        check_begun(folder, resume=False)
    check_begun(folder, resume=True)
    discard(folder)
    check_begun(folder, resume=False)
    discard(folder)


@pytest.mark.parametrize("harm", ["cut", "changed", "empty"])
def test_a_file_that_was_damaged_is_done_again(folder: Path, tmp_path: Path, harm: str) -> None:
    seen = tmp_path / "seen"
    units = [unit(f"plane {k}", text=f"text {k}", seen=str(seen)) for k in range(3)]
    parts = drain(iter_run(units, folder, Threads(1)))
    parts[1].write_text({"cut": "tex", "changed": "text x", "empty": ""}[harm])
    records: list[Progress] = []
    assert texts(drain(iter_run(units, folder, Threads(1)), records.append)) == ["text 0", "text 1", "text 2"]
    assert done(seen) == 4
    assert records[-1].note == "3 of 3 done; 2 by an earlier run"
    assert "damaged" in (folder / JOURNAL).read_text()
    drain(iter_run(units, folder, Threads(1)))
    assert done(seen) == 4


def test_files_that_nobody_noted_are_kept(folder: Path, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    drain(iter_run([unit("a", seen=str(seen))], folder, Threads(1)))
    (folder / JOURNAL).unlink()
    drain(iter_run([unit("a", seen=str(seen))], folder, Threads(1)))
    assert done(seen) == 1


# -- the journal -----------------------------------------------------------------------------------------
def test_a_journal_that_ends_in_half_a_line(folder: Path) -> None:
    drain(iter_run([unit("a"), unit("b")], folder, Threads(1)))
    path = folder / JOURNAL
    whole = path.read_text()
    path.write_text(whole[: whole.rindex("{") + 9])
    assert [u.state for u in read_run(folder).units] == ["done", "done"]
    # the next run begins a line of its own
    drain(iter_run([unit("a"), unit("b"), unit("c")], folder, Threads(1), title="H"))
    state = read_run(folder)
    assert (state.title, [u.name for u in state.units]) == ("H", ["a", "b", "c"])
    assert Counter(u.state for u in state.units) == {"done": 3}


@pytest.mark.parametrize(
    "text",
    ["", "no json\n", '{"at": 1, "event": "begin"}\n', "[1]\n", '{"at": "x", "event": 3}\n'],
    ids=["empty", "text", "lacking", "list", "kinds"],
)
def test_a_journal_that_is_none(folder: Path, text: str) -> None:
    folder.mkdir()
    (folder / JOURNAL).write_text(text)
    with pytest.raises(InputError, match="the folder of a run"):
        read_run(folder)


def test_seconds_and_what_is_left(folder: Path) -> None:
    folder.mkdir()
    begin = {"title": "H", "units": ["a", "b", "c", "d"], "executor": "processes", "workers": 2, "place": ""}
    lines = [
        {"at": 0, "event": "begin", **begin, "process": 1, "host": "elsewhere"},
        {"at": 1, "event": "started", "unit": "a", "worker": "process 7"},
        {"at": 2, "event": "started", "unit": "b", "worker": "process 8"},
        {"at": 11, "event": "done", "unit": "a"},
        {"at": 12, "event": "lost", "unit": "b", "reason": "its process ended"},
        {"at": 13, "event": "started", "unit": "b", "worker": "process 9"},
        {"at": 14, "event": "done", "unit": "a unit of nobody"},
    ]
    (folder / JOURNAL).write_text("".join(json.dumps(line) + "\n" for line in lines))
    state = read_run(folder)
    assert not state.running  # its machine is another one
    assert [(u.state, u.attempts, u.worker) for u in state.units] == [
        ("done", 1, "process 7"),
        ("waiting", 2, "process 9"),
        ("waiting", 0, ""),
        ("waiting", 0, ""),
    ]
    assert state.units[0].seconds == 10
    assert state.eta_seconds == 3 * 10 / 2


def test_a_run_that_goes_on_computes_as_it_was_begun(folder: Path) -> None:
    """What depends on the machine and the moment is settled once for each unit."""

    def units(settled: str, *more: str) -> list[Unit]:
        named = [unit("a", text="a"), unit("b", "refuse"), *(unit(name, "told", of=name) for name in ("c", *more))]
        return [replace(one, settled={"how": settled}) for one in named]

    with pytest.raises(InputError):
        drain(iter_run(units("first"), folder, Threads(1)))
    kept = [unit("a", text="a"), unit("b", text="b"), *units("second", "d")[2:]]
    parts = drain(iter_run(kept, folder, Threads(1)))
    assert [part.read_text() for part in parts[2:]] == ["first", "second"]
    assert [note["values"]["how"] for note in read_notes(folder, SETTLED)] == ["first", "second"]
    discard(folder)
    assert drain(iter_run(units("third")[2:], folder, Threads(1)))[0].read_text() == "third"


def test_a_journal_of_names_that_are_none_is_read(tmp_path: Path) -> None:
    begin = '{"event": "begin", "units": [["a"], {"b": 1}, "c"], "host": "h", "process": 1, "executor": "threads",'
    begin += ' "workers": 1, "title": "t", "place": "", "time": 1.0}'
    lines = [begin, '{"event": "start", "unit": ["a"], "time": 1.0}']
    (tmp_path / JOURNAL).write_text("\n".join(lines) + "\n")
    try:
        assert [unit.name for unit in read_run(tmp_path).units] == ["c"]
    except LfcalError as error:  # a record that is none ends the run's journal
        assert "\n" not in str(error)


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
