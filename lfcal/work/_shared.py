"""Names of `lfcal.work` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.work.held import Held
from lfcal.work.journal import JOURNAL, PASS, Journal, read_events, read_notes
from lfcal.work.numbers import worker_number
from lfcal.work.records import load_record, save_record
from lfcal.work.runs import check_begun, discard, note_joining, unit_files, was_joining
from lfcal.work.table import HEADER, RunTable, run_table
from lfcal.work.unit import file_name, stamp_of

__all__ = [
    "HEADER",
    "JOURNAL",
    "PASS",
    "Held",
    "Journal",
    "RunTable",
    "check_begun",
    "discard",
    "file_name",
    "load_record",
    "note_joining",
    "read_events",
    "read_notes",
    "run_table",
    "save_record",
    "stamp_of",
    "unit_files",
    "was_joining",
    "worker_number",
]
