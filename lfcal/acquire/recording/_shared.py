"""Names of `lfcal.acquire.recording` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.acquire.recording._verify import DamagedFrame, SessionReport, iter_repair, iter_verify, verify
from lfcal.acquire.recording.durable import DiskGuard, FolderLock, holder_of
from lfcal.acquire.recording.opening import open_session
from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.recording.records import RECORD, Kind, Note, Suspicion, file_name, frame_crc, intact
from lfcal.acquire.recording.source import CheckFrame, RecordingSource, TargetRecording, read_checks, sampled_references
from lfcal.acquire.recording.store import Store, recording_bytes
from lfcal.acquire.recording.writer import Acknowledged, Sink, Writer

__all__ = [
    "RECORD",
    "Acknowledged",
    "CheckFrame",
    "DamagedFrame",
    "DiskGuard",
    "FolderLock",
    "Kind",
    "Note",
    "RecordingFile",
    "RecordingSource",
    "SessionReport",
    "Sink",
    "Store",
    "Suspicion",
    "TargetRecording",
    "Writer",
    "file_name",
    "frame_crc",
    "holder_of",
    "intact",
    "iter_repair",
    "iter_verify",
    "open_session",
    "read_checks",
    "recording_bytes",
    "sampled_references",
    "verify",
]
