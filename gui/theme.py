"""Light and dark: colours, style sheet, plot colours; icons are drawn, none are fetched."""

from __future__ import annotations

from dataclasses import dataclass

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QIcon, QPainter, QPainterPath, QPalette, QPen, QPixmap
from PySide6.QtWidgets import QApplication

__all__ = ["DARK", "LIGHT", "Theme", "apply_theme", "current_theme", "stage_icon"]


@dataclass(frozen=True)
class Theme:
    """Colours of one theme, as ``#rrggbb``."""

    name: str
    window: str
    panel: str
    raised: str
    line: str
    text: str
    muted: str
    accent: str
    accent_text: str
    good: str
    fair: str
    bad: str
    plot: str


LIGHT = Theme(
    "light",
    "#f4f5f7",
    "#ffffff",
    "#eef0f3",
    "#d5d9e0",
    "#1b1f27",
    "#667085",
    "#0b6e99",
    "#ffffff",
    "#2e7d32",
    "#b26a00",
    "#c62828",
    "#ffffff",
)
DARK = Theme(
    "dark",
    "#16191f",
    "#1e222a",
    "#282d37",
    "#3a404c",
    "#e6e9ef",
    "#98a2b3",
    "#4db6dd",
    "#0d1117",
    "#66bb6a",
    "#ffb74d",
    "#ef5350",
    "#1e222a",
)

_current = [LIGHT]


def current_theme() -> Theme:
    """Return the theme in use."""
    return _current[0]


def apply_theme(app: QApplication, theme: Theme) -> None:
    """Give the whole application the colours of ``theme``."""
    _current[0] = theme
    app.setStyle("Fusion")
    palette = QPalette()
    roles = QPalette.ColorRole
    for role, colour in (
        (roles.Window, theme.window),
        (roles.Base, theme.panel),
        (roles.AlternateBase, theme.raised),
        (roles.Button, theme.raised),
        (roles.WindowText, theme.text),
        (roles.Text, theme.text),
        (roles.ButtonText, theme.text),
        (roles.ToolTipBase, theme.raised),
        (roles.ToolTipText, theme.text),
        (roles.PlaceholderText, theme.muted),
        (roles.Highlight, theme.accent),
        (roles.HighlightedText, theme.accent_text),
        (roles.Link, theme.accent),
        (roles.Mid, theme.line),
        (roles.Light, theme.panel),
        (roles.Dark, theme.line),
    ):
        palette.setColor(role, QColor(colour))
    for role in (roles.Text, roles.WindowText, roles.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, role, QColor(theme.muted))
    app.setPalette(palette)
    app.setStyleSheet(_STYLE.format(**vars(theme)))


_STYLE = """
QWidget {{ font-size: 10pt; }}
QToolTip {{ color: {text}; background: {raised}; border: 1px solid {line}; padding: 4px; }}
QMainWindow::separator {{ background: {line}; width: 1px; height: 1px; }}
QLabel[role="title"] {{ font-size: 15pt; font-weight: 600; }}
QLabel[role="heading"] {{ font-weight: 600; color: {text}; }}
QLabel[role="hint"] {{ color: {muted}; }}
QLabel[role="error"] {{ color: {bad}; }}
QLabel[role="value"] {{ font-weight: 600; }}
QFrame[role="card"] {{ background: {panel}; border: 1px solid {line}; border-radius: 6px; }}
QListWidget#rail {{ background: {panel}; border: none; border-right: 1px solid {line}; outline: 0; padding: 6px; }}
QListWidget#rail::item {{ padding: 7px 8px; border-radius: 6px; margin: 1px 0; color: {text}; }}
QListWidget#rail::item:selected {{ background: {accent}; color: {accent_text}; }}
QListWidget#rail::item:hover:!selected {{ background: {raised}; }}
QPushButton {{ background: {raised}; border: 1px solid {line}; border-radius: 5px; padding: 5px 12px; }}
QPushButton:hover {{ border-color: {accent}; }}
QPushButton:disabled {{ color: {muted}; background: {window}; }}
QPushButton:checked {{ background: {accent}; color: {accent_text}; border-color: {accent}; }}
QPushButton[role="primary"] {{ background: {accent}; color: {accent_text}; border-color: {accent}; font-weight: 600; }}
QPushButton[role="primary"]:disabled {{ background: {raised}; color: {muted}; border-color: {line}; }}
QLineEdit, QPlainTextEdit, QTextEdit {{
    background: {panel}; border: 1px solid {line}; border-radius: 4px; padding: 3px 6px;
    selection-background-color: {accent}; selection-color: {accent_text}; }}
QLineEdit:focus {{ border-color: {accent}; }}
QCheckBox::indicator {{ width: 13px; height: 13px; border: 1px solid {muted}; border-radius: 3px;
    background: {panel}; }}
QCheckBox::indicator:checked {{ background: {accent}; border-color: {accent}; }}
QCheckBox::indicator:disabled {{ border-color: {line}; }}
QComboBox {{ min-height: 22px; }}
QLineEdit[invalid="true"] {{ border: 1px solid {bad}; }}
QComboBox QAbstractItemView {{ background: {panel}; border: 1px solid {line}; selection-background-color: {accent};
    selection-color: {accent_text}; }}
QTableView, QTreeView, QListView, QTableWidget, QTreeWidget {{ background: {panel}; border: 1px solid {line};
    border-radius: 4px; gridline-color: {raised}; alternate-background-color: {window}; }}
QHeaderView::section {{ background: {raised}; border: none; border-bottom: 1px solid {line}; padding: 4px 6px;
    font-weight: 600; }}
QProgressBar {{ background: {raised}; border: none; border-radius: 3px; max-height: 8px; min-height: 8px; }}
QProgressBar::chunk {{ background: {accent}; border-radius: 3px; }}
QSplitter::handle {{ background: {line}; }}
QSplitter::handle:horizontal {{ width: 1px; }}
QSplitter::handle:vertical {{ height: 1px; }}
QScrollArea {{ border: none; background: transparent; }}
QDockWidget::title {{ background: {raised}; padding: 5px 8px; }}
QTabBar::tab {{ padding: 6px 12px; border: none; border-bottom: 2px solid transparent; color: {muted}; }}
QTabBar::tab:selected {{ color: {text}; border-bottom-color: {accent}; }}
QTabWidget::pane {{ border: none; border-top: 1px solid {line}; }}
QStatusBar {{ background: {panel}; border-top: 1px solid {line}; }}
QMenuBar {{ background: {panel}; border-bottom: 1px solid {line}; }}
QMenuBar::item:selected, QMenu::item:selected {{ background: {accent}; color: {accent_text}; }}
QMenu {{ background: {panel}; border: 1px solid {line}; padding: 4px; }}
QMenu::item {{ padding: 5px 22px; border-radius: 4px; }}
QMenu::separator {{ height: 1px; background: {line}; margin: 4px 8px; }}
QSlider::groove:horizontal {{ height: 4px; background: {line}; border-radius: 2px; }}
QSlider::sub-page:horizontal {{ background: {accent}; border-radius: 2px; }}
QSlider::handle:horizontal {{ background: {accent}; width: 14px; height: 14px; margin: -5px 0; border-radius: 7px; }}
QSlider::groove:vertical {{ width: 4px; background: {line}; border-radius: 2px; }}
QSlider::handle:vertical {{ background: {accent}; width: 14px; height: 14px; margin: 0 -5px; border-radius: 7px; }}
"""


def stage_icon(key: str, colour: str, size: int = 22) -> QIcon:
    """Return a line icon for a stage, drawn at twice its size for sharp screens."""
    pixmap = QPixmap(size * 2, size * 2)
    pixmap.setDevicePixelRatio(2.0)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setPen(QPen(QColor(colour), 1.6, Qt.PenStyle.SolidLine, Qt.PenCapStyle.RoundCap))
    painter.scale(size / 22, size / 22)
    _DRAW.get(key, _draw_dot)(painter)
    painter.end()
    return QIcon(pixmap)


def _draw_camera(p: QPainter) -> None:
    p.drawRoundedRect(QRectF(2, 6, 18, 12), 2, 2)
    p.drawEllipse(QPointF(11, 12), 3.6, 3.6)
    p.drawLine(QPointF(7, 6), QPointF(8.5, 3.5))
    p.drawLine(QPointF(8.5, 3.5), QPointF(13.5, 3.5))
    p.drawLine(QPointF(13.5, 3.5), QPointF(15, 6))


def _draw_plan(p: QPainter) -> None:
    path = QPainterPath(QPointF(3, 4))
    for x, y in ((19, 4), (19, 9), (3, 9), (3, 14), (19, 14), (19, 19), (3, 19)):
        path.lineTo(x, y)
    p.drawPath(path)


def _draw_acquire(p: QPainter) -> None:
    p.drawEllipse(QPointF(11, 11), 8, 8)
    p.setBrush(p.pen().color())
    p.drawEllipse(QPointF(11, 11), 3, 3)


def _draw_frames(p: QPainter) -> None:
    p.drawRect(QRectF(3, 7, 12, 12))
    p.drawLine(QPointF(6, 4), QPointF(18, 4))
    p.drawLine(QPointF(18, 4), QPointF(18, 16))


def _draw_psf(p: QPainter) -> None:
    for x in (5.5, 11, 16.5):
        for y in (5.5, 11, 16.5):
            p.drawEllipse(QPointF(x, y), 1.9, 1.9)


def _draw_quality(p: QPainter) -> None:
    p.drawEllipse(QPointF(11, 11), 8.5, 8.5)
    path = QPainterPath(QPointF(6.5, 11.5))
    path.lineTo(10, 15)
    path.lineTo(16, 7.5)
    p.drawPath(path)


def _draw_simulate(p: QPainter) -> None:
    path = QPainterPath(QPointF(2, 11))
    path.cubicTo(QPointF(5, 0), QPointF(8, 0), QPointF(11, 11))
    path.cubicTo(QPointF(14, 22), QPointF(17, 22), QPointF(20, 11))
    p.drawPath(path)


def _draw_reconstruct(p: QPainter) -> None:
    for a, b in (
        ((11, 2), (19, 6.5)),
        ((19, 6.5), (19, 15.5)),
        ((19, 15.5), (11, 20)),
        ((11, 20), (3, 15.5)),
        ((3, 15.5), (3, 6.5)),
        ((3, 6.5), (11, 2)),
        ((11, 11), (11, 20)),
        ((11, 11), (19, 6.5)),
        ((11, 11), (3, 6.5)),
    ):
        p.drawLine(QPointF(*a), QPointF(*b))


def _draw_multiplex(p: QPainter) -> None:
    p.drawRect(QRectF(3, 3, 16, 16))
    p.drawLine(QPointF(11, 3), QPointF(11, 19))
    p.drawLine(QPointF(3, 11), QPointF(19, 11))
    p.fillRect(QRectF(3, 3, 8, 8), p.pen().color())
    p.fillRect(QRectF(11, 11, 8, 8), p.pen().color())


def _draw_dot(p: QPainter) -> None:
    p.drawEllipse(QPointF(11, 11), 4, 4)


_DRAW = {
    "camera": _draw_camera,
    "plan": _draw_plan,
    "acquire": _draw_acquire,
    "frames": _draw_frames,
    "psf": _draw_psf,
    "quality": _draw_quality,
    "simulate": _draw_simulate,
    "reconstruct": _draw_reconstruct,
    "multiplex": _draw_multiplex,
}
