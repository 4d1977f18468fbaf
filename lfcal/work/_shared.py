"""Names of `lfcal.work` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.work.journal import HEADER, JOURNAL, PASS, Journal, RunTable, read_events, read_notes, run_table
from lfcal.work.records import load_record, save_record
from lfcal.work.runs import check_begun, discard, note_joining, unit_files, was_joining
from lfcal.work.unit import ProcessCache, file_name, stamp_of, worker_number

__all__ = [
    "HEADER",
    "JOURNAL",
    "PASS",
    "Journal",
    "ProcessCache",
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
