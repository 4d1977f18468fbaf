"""Runs of units: finished units are kept, lost ones are tried again, and nothing half-written stays."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import InputError, LfcalError, StorageError
from lfcal.base.files import only_writer, replace_whole
from lfcal.base.progress import Clock, Progress, Work, drain
from lfcal.base.system import is_alive
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


def run(units: list[Unit], folder: Path, executor: Any = None, *watch: Any, **more: Any) -> tuple[Path, ...]:
    return drain(iter_run(units, folder, executor or Threads(1), **more), *watch)


def texts(parts: tuple[Path, ...]) -> list[str]:
    return [part.read_text() for part in parts]


def listed(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def done(seen: Path) -> int:
    return len(seen.read_text().splitlines()) if seen.exists() else 0


def test_parts_are_in_the_order_of_units_and_progress_is_that_of_all(folder: Path) -> None:
    records: list[Progress] = []
    parts = run([unit(f"plane {k}", text=f"{k}") for k in range(5)], folder, Threads(2), records.append)
    assert texts(parts) == list("01234")
    fractions = [record.fraction for record in records]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    assert records[-1].note == "5 of 5 done"


def test_units_that_are_done_are_kept_unless_their_file_is_lost_or_damaged(folder: Path, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    units = [unit(f"plane {k}", text=f"text {k}", seen=str(seen)) for k in range(3)]
    parts = run(units, folder)
    wanted, count = texts(parts), 3
    for harm in (None, "tex", "text x", ""):
        parts[1].unlink() if harm is None else parts[1].write_text(harm)
        records: list[Progress] = []
        assert texts(run(units, folder, None, records.append)) == wanted
        count += 1
        assert done(seen) == count and records[-1].note == "3 of 3 done; 2 by an earlier run", harm
    assert "damaged" in (folder / JOURNAL).read_text()
    (folder / JOURNAL).unlink()  # files without a note are kept as well
    run(units, folder)
    assert done(seen) == count


def test_units_with_other_settings_are_done_again_and_their_old_files_removed(folder: Path) -> None:
    run([unit("a", text="old"), unit("b", text="b")], folder)
    parts = run([unit("a", text="new"), unit("b", text="b")], folder)
    assert texts(parts) == ["new", "b"]
    assert listed(folder) == {JOURNAL, *(part.name for part in parts)}


def test_runs_that_cannot_be_are_refused(folder: Path) -> None:
    folder.mkdir()
    with only_writer(folder), pytest.raises(StorageError, match="another program is writing"):
        run([unit("a")], folder)
    with pytest.raises(InputError, match="expected the file"):  # the task wrote nothing
        run([unit("a", "forget")], folder)
    with pytest.raises(InputError, match="a name for each"):
        run([unit("a"), unit("a", text="y")], folder)


def test_a_refusal_ends_the_run_keeps_the_rest_and_the_next_run_is_asked(folder: Path) -> None:
    check_begun(folder, resume=False)
    folder.mkdir()
    (folder / JOURNAL).touch()
    check_begun(folder, resume=False)  # a run that was killed before it began blocks nothing
    with pytest.raises(InputError, match="open the shutter"):
        run([unit("a"), unit("b", "refuse"), unit("c")], folder)
    state = read_run(folder)
    assert [u.state for u in state.units] == ["done", "failed", "waiting"]
    assert "open the shutter" in state.units[1].reason and not state.running
    words = r"left 1 of 3 units finished; continue from them \(--resume\), or start again \(--force\)"
    with pytest.raises(InputError, match=words):
        check_begun(folder, resume=False)
    check_begun(folder, resume=True)
    for _ in range(2):
        discard(folder)
        check_begun(folder, resume=False)


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


@pytest.mark.parametrize(("joined", "room"), [(False, 4), (True, 9)])
def test_a_disk_that_is_too_small_is_reported_after_the_first_unit(
    folder: Path, monkeypatch: pytest.MonkeyPatch, joined: bool, room: int
) -> None:
    """Five units of 3 MB, or ten with those joined: one is there, so the others need four, or nine."""
    size, extra = 3 << 20, (1 << 20) + (1 << 18)  # what HDF5 needs besides the data
    usage = shutil.disk_usage(folder.parent)
    units = [unit(f"plane {k}", text=f"{k}" * size) for k in range(5)]
    for free, count in (((room - 1) * size + extra, 1), (room * size + extra, 5)):
        monkeypatch.setattr("lfcal.base.files.shutil.disk_usage", lambda _, free=free: usage._replace(free=free))
        if count == 5:
            assert len(run(units, folder, joined=joined)) == 5
            return
        with pytest.raises(StorageError, match=r"disk space for the remaining files .*: expected at least .*, got "):
            run(units, folder, joined=joined)
        assert read_run(folder).count("done") == count


# -- processes -------------------------------------------------------------------------------------------


def test_processes_that_are_killed_are_replaced(folder: Path, tmp_path: Path) -> None:
    seen = tmp_path / "seen"
    units = [unit(f"plane {k}", text=f"{k}", seen=str(seen)) for k in range(4)]
    units[1] = unit("plane 1", "die", text="1", times=2, marks=str(tmp_path / "marks"), seen=str(seen))
    parts = run(units, folder, Processes(2))
    lines = [line.split() for line in seen.read_text().splitlines()]
    assert texts(parts) == list("0123") and len(lines) == 4
    assert {(threads, stated) for _, threads, stated in lines} == {("1", "1")}
    state = read_run(folder).units[1]
    assert (state.state, state.attempts) == ("done", 3)
    assert listed(folder) == {JOURNAL, *(part.name for part in parts)}


def test_a_unit_whose_worker_always_ends_is_given_up(folder: Path, tmp_path: Path) -> None:
    units = [unit("plane 0", "die", times=9, marks=str(tmp_path / "marks"))]
    with pytest.raises(WorkerLost, match=r"plane 0: its process ended \(signal 9\) in each of 2 attempts"):
        run(units, folder, Processes(1), attempts=2)
    assert read_run(folder).units[0].state == "failed" and listed(folder) == {JOURNAL}


def test_each_process_has_a_number_which_its_successor_takes(folder: Path, tmp_path: Path) -> None:
    assert texts(run([unit("a", "count"), unit("b", "count")], folder, Processes(2))) == ["0", "1"]
    ends = unit("c", "die", times=1, marks=str(tmp_path / "marks"))
    assert texts(run([ends, unit("d", "count"), unit("e", "count")], folder, Processes(1)))[1:] == ["0", "0"]
    assert texts(run([unit("f", "count")], folder)) == ["0"]
    with numbered("tcp://10.0.0.1:4000"):
        first = worker_number()
    with numbered("tcp://10.0.0.1:4000"), numbered(2):
        assert worker_number() == 2
    with numbered("tcp://10.0.0.1:4000"):
        assert worker_number() == first > 0
    assert worker_number() == 0


def test_faults_in_processes_are_named_and_files_in_use_tried_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="open the shutter"):
        run([unit("a", "refuse")], folder, Processes(1))
    with pytest.raises(TaskFailed, match=r"ZeroDivisionError at tasks\.py:\d+: one by nothing"):
        run([unit("a", "stumble")], folder, Processes(1))
    monkeypatch.setattr("lfcal.work.runs.PAUSE", 0.01)
    parts = run([unit("a", "busy_file", marks=str(tmp_path / "marks"))], folder, Processes(1))
    assert texts(parts) == ["x"]


@pytest.mark.parametrize("executor", [Threads, Processes])
def test_closing_ends_the_workers_and_leaves_nothing_half_written(
    folder: Path, tmp_path: Path, executor: type[Threads | Processes]
) -> None:
    begun = tmp_path / "begun"
    work = iter_run([unit("a"), unit("b", "endless", begun=str(begun))], folder, executor(1))
    for _ in work:
        if begun.exists() and begun.read_text():
            break
    work.close()
    assert executor is Threads or not is_alive(int(begun.read_text()))
    assert [path.suffix for path in folder.iterdir() if path.name != JOURNAL] == [".txt"]
    assert [u.state for u in read_run(folder).units] == ["done", "waiting"]
    assert texts(run([unit("b", text="whole")], folder)) == ["whole"]


@pytest.mark.parametrize("harm", ["", "changed"])
def test_the_file_of_a_worker_is_trusted_unless_it_changed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, harm: str
) -> None:
    """H of a unit is joined without another process that reads it first, unless the file has changed."""

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


# -- the journal -----------------------------------------------------------------------------------------
def test_a_journal_that_ends_in_half_a_line_is_continued(folder: Path) -> None:
    run([unit("a"), unit("b")], folder)
    path = folder / JOURNAL
    whole = path.read_text()
    path.write_text(whole[: whole.rindex("{") + 9])
    assert [u.state for u in read_run(folder).units] == ["done", "done"]
    # the next run begins a line of its own
    run([unit("a"), unit("b"), unit("c")], folder, title="H")
    state = read_run(folder)
    assert (state.title, [u.name for u in state.units]) == ("H", ["a", "b", "c"])
    assert {u.state for u in state.units} == {"done"}


def test_other_files_are_no_journal_and_crafted_names_are_left_out(folder: Path) -> None:
    folder.mkdir()
    for text in ("", "no json\n", '{"at": 1, "event": "begin"}\n', "[1]\n", '{"at": "x", "event": 3}\n'):
        (folder / JOURNAL).write_text(text)
        with pytest.raises(InputError, match="the folder of a run"):
            read_run(folder)
    begin = '{"event": "begin", "units": [["a"], {"b": 1}, "c"], "host": "h", "process": 1, "executor": "threads",'
    begin += ' "workers": 1, "title": "t", "place": "", "time": 1.0}'
    (folder / JOURNAL).write_text("\n".join([begin, '{"event": "start", "unit": ["a"], "time": 1.0}']) + "\n")
    try:
        assert [unit.name for unit in read_run(folder).units] == ["c"]
    except LfcalError as error:  # a damaged record ends the run's journal
        assert "\n" not in str(error)


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
        {"at": 14, "event": "done", "unit": "another unit"},
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


def test_a_resumed_run_keeps_the_settings_of_each_unit(folder: Path) -> None:
    """What depends on the machine and the moment is settled once for each unit."""

    def units(settled: str, *more: str) -> list[Unit]:
        named = [unit("a", text="a"), unit("b", "refuse"), *(unit(name, "told", of=name) for name in ("c", *more))]
        return [replace(one, settled={"how": settled}) for one in named]

    with pytest.raises(InputError):
        run(units("first"), folder)
    kept = [unit("a", text="a"), unit("b", text="b"), *units("second", "d")[2:]]
    assert texts(run(kept, folder))[2:] == ["first", "second"]
    assert [note["values"]["how"] for note in read_notes(folder, SETTLED)] == ["first", "second"]
    discard(folder)
    assert texts(run(units("third")[2:], folder)) == ["third"]


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
@pytest.mark.parametrize("choice", [RunChoice("threads", 1), RunChoice("processes", 2)])
def test_parts_are_joined_to_the_same_whole(tmp_path: Path, choice: RunChoice, in_order: bool) -> None:
    join = Joining(tmp_path / "out")
    units = [unit(f"plane {k}", text=f"{k}") for k in range(5)]
    records = []
    drain(iter_made(units, join.out, choice, join, title="", in_order=in_order), records.append)
    assert join.out.read_text() == "01234" and join.taken == list("01234")
    assert records[-1].stage == "joining" and records[-1].fraction == 1.0
    assert listed(tmp_path) == {"out"}


def test_parts_are_joined_while_units_are_under_way(tmp_path: Path) -> None:
    """The last unit ends when the first two were joined; until then the whole is not noted as written."""
    join = Joining(tmp_path / "out", tmp_path / "marks")
    last = unit("c", "meet", marks=str(join.marks), count=3)
    units = [unit("a", text="a"), unit("b", text="b"), last]
    drain(iter_made(units, join.out, RunChoice("threads", 1), join, title="", in_order=True))
    assert join.out.read_text() == "ab0"
    assert join.noted[:2] == [False, False]


def test_a_join_that_fails_or_is_closed_leaves_only_the_units(tmp_path: Path) -> None:
    join, one = Joining(tmp_path / "out"), RunChoice("threads", 1)
    units = [unit("a", text="a"), unit("b", "endless", begun=str(tmp_path / "begun")), unit("c")]
    work = iter_made(units, join.out, one, join, title="", in_order=True)
    for _ in work:
        if join.taken:
            break
    work.close()
    assert listed(tmp_path) == {"begun", "out.parts"}
    again = RunChoice("threads", 1, begun="resume")
    units[1] = unit("b", "refuse")
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_made(units, join.out, again, join, title="", in_order=True))
    assert listed(tmp_path) == {"begun", "out.parts"} and not was_joining(join.out)
    units[1] = unit("b", text="b")
    drain(iter_made(units, join.out, again, join, title="", in_order=True))
    assert join.out.read_text()[-3:] == "abx" and not parts_folder(join.out).exists()


def test_no_step_is_taken_for_a_missing_file(tmp_path: Path) -> None:
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
