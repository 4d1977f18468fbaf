"""The line of a page in the status bar."""

from __future__ import annotations

from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.notice import Notice

WHY = "frames: expected grey frames, got colour frames of 3 channels; choose a channel in the dialog of the import"


def test_a_message_without_room_is_opened_whole(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    notice = Notice(root)
    root.resize(1200, 80)
    root.show()
    notice.setGeometry(0, 50, 1200, 24)
    notice.refuse(WHY)
    QApplication.processEvents()
    assert not notice.more.isVisible()
    notice.setGeometry(0, 50, 500, 24)
    QApplication.processEvents()
    assert notice.more.isVisible() and notice.label.toolTip() == WHY
    words = notice.show_whole()
    notice.refuse(f"/data/{'long_' * 20}name.h5: expected an HDF5 file, got 3000 bytes")
    assert "name.h5: expected an HDF5 " in QLabel.text(notice.label), "the reason counts more than the path"
    assert words.isVisible() and words.text() == WHY and words.height() >= words.heightForWidth(words.width())
    words.window().close()


def test_the_second_button_says_what_it_does(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    notice = Notice(root)
    notice.offer(
        "Dark frames", "Continue", lambda: None, stay="Skip", tip="Go on", stay_tip="Record without dark frames"
    )
    assert (notice.leave.text(), notice.leave.toolTip()) == ("Skip", "Record without dark frames")
    notice.offer("Removed", "Undo", lambda: None, stay="Leave it", tip="Restore the plan")
    assert notice.leave.toolTip() == "Hide this message without any change"
