"""What decoders in C write to standard error is caught, and nothing else is lost of it."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.frames.formats._decoder_messages import caught_messages
from lfcal.frames.formats.image_file import read_image


def test_complaints_are_kept_and_other_words_passed_on(capfd: pytest.CaptureFixture[str]) -> None:
    with caught_messages("a.png") as complaint:
        os.write(2, b"libpng error: bad, a.png\nwords of another thread\n")
    assert complaint() == "libpng error: bad, a.png"
    assert capfd.readouterr().err == "words of another thread\n"


def test_users_at_the_same_time(capfd: pytest.CaptureFixture[str]) -> None:
    found: dict[int, str] = {}
    both = threading.Barrier(4)

    def work(k: int) -> None:
        with caught_messages(f"file {k}.png") as complaint:
            both.wait()
            os.write(2, f"libpng error: file {k}.png\n".encode())
            both.wait()
        found[k] = complaint()

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {k: f"libpng error: file {k}.png" for k in range(4)}
    os.write(2, b"after\n")
    assert capfd.readouterr().err == "after\n"


def test_images_are_read_without_room_for_temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    frame = np.arange(24, dtype=np.uint16).reshape(4, 6)
    cv2.imwrite(str(tmp_path / "a.png"), frame)
    assert read_image(tmp_path / "a.png").shape == frame.shape, "the decoder's kernels are compiled by now"
    monkeypatch.setattr("tempfile.TemporaryFile", full)
    assert np.array_equal(read_image(tmp_path / "a.png"), frame)
