"""Light and dark: colours, style sheet, plot colours."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol, runtime_checkable

from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication

_STYLE = """
QToolTip {{ color: {text}; background: {raised}; border: 1px solid {line}; padding: 4px; }}
QMainWindow::separator {{ background: {line}; width: 1px; height: 1px; }}
QLabel[role="title"] {{ font-size: 15pt; font-weight: 600; }}
QLabel[role="lead"] {{ font-size: 11pt; font-weight: 600; color: {accent}; }}
QLabel[role="next"] {{ font-size: 11pt; font-weight: 500; color: {text}; }}
QLabel[role="heading"] {{ font-weight: 600; color: {text}; }}
QLabel[role="hint"] {{ color: {muted}; }}
QLabel[role="error"], QToolButton[role="error"] {{ color: {bad}; }}
QToolButton[role="mark"], QToolButton[role="reset"] {{ border: 1px solid transparent; border-radius: 4px;
    background: transparent; padding: 0; }}
QToolButton[role="mark"][mark="assumed"] {{ color: {fair}; border-color: {fair}; }}
QLabel[mark="measured"], QLabel[mark="stated"] {{ color: {good}; }}
QLabel[mark="derived"] {{ color: {muted}; }}
QToolButton[role="reset"] {{ color: {accent}; }}
QToolButton[role="mark"][mark="assumed"]:hover, QToolButton[role="reset"]:hover {{ background: {raised}; }}
QToolButton[role="mark"]:focus, QToolButton[role="reset"]:focus {{ border: 2px solid {accent}; }}
*[changed="true"] {{ font-weight: 600; }}
QLabel[role="value"] {{ font-weight: 600; }}
QFrame[role="card"] {{ background: {panel}; border: 1px solid {line}; border-radius: 6px; }}
QFrame#rail {{ background: {panel}; border: none; border-right: 1px solid {line}; }}
QFrame[role="verdict"] {{ background: {panel}; border: 1px solid {line}; border-left: 4px solid {muted};
    border-radius: 6px; }}
QFrame[role="verdict"][merit="good"] {{ border-left-color: {good}; }}
QFrame[role="verdict"][merit="fair"] {{ border-left-color: {fair}; }}
QFrame[role="verdict"][merit="bad"] {{ border-left-color: {bad}; }}
QFrame[role="verdict"] QLabel {{ border: none; }}
QFrame#header {{ background: {panel}; border: none; border-bottom: 1px solid {line}; }}
QLabel[size="caption"] {{ font-size: 8pt; }}
QLabel[role="good"] {{ color: {good}; }}
QLabel[role="fair"] {{ color: {fair}; }}
QLabel[role="bad"] {{ color: {bad}; }}
QPushButton {{ background: {raised}; border: 1px solid {line}; border-radius: 5px; padding: 5px 12px; }}
QPushButton:hover, QPushButton:focus {{ border-color: {accent}; }}
QPushButton:disabled {{ color: {muted}; background: {window}; }}
QPushButton[checkable="true"] {{ background: transparent; }}
QPushButton:checked {{ background: {raised}; color: {accent}; border-color: {accent}; }}
QPushButton[role="rail"] {{ background: transparent; border: 1px solid transparent; border-radius: 7px; padding: 0; }}
QPushButton[role="rail"]:hover {{ background: {raised}; }}
QPushButton[role="rail"]:checked {{ background: {raised}; border-left: 3px solid {accent}; }}
QPushButton[role="rail"]:focus {{ border-color: {accent}; }}
QPushButton[role="segment"] {{ background: transparent; border: none; border-bottom: 2px solid transparent;
    border-radius: 0; color: {muted}; padding: 4px 9px; }}
QPushButton[role="segment"]:hover {{ color: {text}; }}
QPushButton[role="segment"]:checked {{ background: transparent; color: {text};
    border-bottom-color: {accent}; }}
QPushButton[role="segment"]:focus {{ color: {accent}; }}
QPushButton[role="tight"] {{ padding: 2px 8px; }}
QPushButton[role="link"] {{ background: transparent; border: 1px solid transparent; color: {accent};
    padding: 2px 4px; }}
QPushButton[role="row"] {{ background: transparent; border: none; border-top: 1px solid {line}; border-radius: 0; }}
QPushButton[role="row"]:hover {{ background: {raised}; }}
QPushButton[role="link"]:focus, QPushButton[role="row"]:focus {{ border: 1px solid {accent}; }}
QToolButton[role="bare"] {{ border: 2px solid transparent; border-radius: 4px; background: transparent; font-size: 13pt;
    padding: 0 4px; color: {text}; }}
QToolButton[role="bare"]:focus {{ border-color: {accent}; }}
QToolButton[role="bare"]::menu-indicator {{ image: none; }}
QPushButton[role="primary"] {{ background: {accent}; color: {accent_text}; border-color: {accent}; font-weight: 600; }}
QPushButton[role="primary"]:focus {{ border-color: {text}; }}
QPushButton[role="fold"] {{ border: 1px solid transparent; border-radius: 4px; background: transparent;
    font-weight: 600; padding: 3px 0; color: {text}; text-align: left; }}
QPushButton[role="fold"][ruled="true"] {{ border-top: 1px solid {line}; border-radius: 0; }}
QPushButton[role="fold"]:hover {{ color: {accent}; }}
QPushButton[role="fold"]:checked {{ background: transparent; }}
QPushButton[role="fold"]:focus {{ border: 2px solid {accent}; border-radius: 4px; }}
QPushButton[role="big"] {{ font-size: 16pt; font-weight: 600; min-height: 54px; padding: 4px 10px; }}
QPushButton[role="big"]:disabled {{ font-weight: 400; }}
QLabel[role="big"] {{ font-size: 17pt; font-weight: 600; color: {text}; }}
QPushButton[role="primary"]:disabled {{ background: {raised}; color: {muted}; border-color: {line}; }}
QLineEdit, QPlainTextEdit, QTextEdit {{
    background: {panel}; border: 1px solid {edge}; border-radius: 4px; padding: 3px 6px;
    selection-background-color: {accent}; selection-color: {accent_text}; }}
QLineEdit:disabled, QPlainTextEdit:disabled, QTextEdit:disabled {{ background: {window}; border-color: {line}; }}
QLineEdit:focus, QPlainTextEdit:focus, QTextEdit:focus {{ border-color: {accent}; }}
QCheckBox::indicator, QAbstractItemView::indicator {{ width: 13px; height: 13px; border: 1px solid {muted};
    border-radius: 3px; background: {panel}; }}
QCheckBox::indicator:checked, QAbstractItemView::indicator:checked {{ background: {accent}; border-color: {accent};
    image: url("{tick}"); }}
QCheckBox::indicator:disabled, QAbstractItemView::indicator:disabled {{ border-color: {line}; }}
QComboBox {{ min-height: 22px; background: {raised}; border: 1px solid {edge}; border-radius: 4px; padding: 0 4px; }}
QComboBox:focus {{ border-color: {accent}; }}
QComboBox:disabled {{ background: {window}; border-color: {line}; color: {muted}; }}
QComboBox::drop-down {{ border: 0; width: 16px; }}
QComboBox::down-arrow {{ image: url("{arrow}"); width: 9px; height: 9px; }}
QWidget[dense="true"] QLineEdit {{ padding: 1px 4px; }}
QWidget[dense="true"] QPushButton {{ padding: 3px 10px; }}
QWidget[dense="true"] QPushButton[role="fold"] {{ padding: 3px 0; }}
QWidget[dense="true"] QPushButton[role="tight"] {{ padding: 3px 6px; }}
QWidget[dense="true"] QComboBox {{ min-height: 17px; max-height: 17px; }}
QLineEdit[invalid="true"] {{ border: 1px solid {bad}; }}
QComboBox QAbstractItemView {{ background: {panel}; border: 1px solid {line}; selection-background-color: {accent};
    selection-color: {accent_text}; }}
QTableView, QTreeView, QListView, QTableWidget, QTreeWidget {{ background: {panel}; border: 1px solid {line};
    border-radius: 4px; gridline-color: {raised}; alternate-background-color: {window}; }}
QTableView:focus, QTreeView:focus, QListView:focus {{ border-color: {accent}; }}
QLabel:focus {{ background: {raised}; }}
QHeaderView::section {{ background: {raised}; border: none; border-bottom: 1px solid {line}; padding: 4px;
    font-weight: 600; }}
QProgressBar {{ background: {raised}; border: none; border-radius: 3px; max-height: 8px; min-height: 8px; }}
QProgressBar::chunk {{ background: {accent}; border-radius: 3px; }}
QSplitter::handle {{ background: transparent; }}
QSplitter::handle:horizontal {{ width: 1px; }}
QSplitter::handle:vertical {{ height: 1px; }}
QWidget#looks {{ background: {canvas}; }}
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
QScrollBar {{ background: transparent; }}
QScrollBar:vertical {{ width: 10px; }}
QScrollBar:horizontal {{ height: 10px; }}
QScrollBar::handle {{ background: {edge}; border-radius: 4px; margin: 1px; }}
QScrollBar::handle:vertical {{ min-height: 24px; }}
QScrollBar::handle:horizontal {{ min-width: 24px; }}
QScrollBar::handle:hover {{ background: {muted}; }}
QScrollBar::add-line, QScrollBar::sub-line {{ width: 0; height: 0; }}
QSlider::groove:horizontal {{ height: 4px; background: {line}; border-radius: 2px; }}
QSlider::sub-page:horizontal {{ background: {accent}; border-radius: 2px; }}
QSlider::handle:horizontal {{ background: {accent}; width: 14px; height: 14px; margin: -5px 0; border-radius: 7px; }}
QSlider::groove:vertical {{ width: 4px; background: {line}; border-radius: 2px; }}
QSlider::handle:vertical {{ background: {accent}; width: 14px; height: 14px; margin: 0 -5px; border-radius: 7px; }}
QSlider::handle:focus {{ background: {text}; }}
"""


@dataclass(frozen=True)
class Theme:
    """Colours of one theme, as ``#rrggbb``.

    ``edge`` is the border of input fields. ``canvas`` is the background of pictures, and of text shown in their place.
    ``red`` states whether all colours are red on black, for a dark lab.
    """

    name: str
    window: str
    panel: str
    raised: str
    line: str
    edge: str
    text: str
    muted: str
    accent: str
    accent_text: str
    good: str
    fair: str
    bad: str
    canvas: str = "#0b0d10"
    canvas_text: str = "#9eabba"
    red: bool = False


LIGHT = Theme(
    "light",
    window="#eef1f4",
    panel="#ffffff",
    raised="#edf0f4",
    line="#d7dde4",
    edge="#7f8b99",
    text="#131c26",
    muted="#546271",
    accent="#0a6a94",
    accent_text="#ffffff",
    good="#1b7540",
    fair="#8a5200",
    bad="#b3261e",
)
DARK = Theme(
    "dark",
    window="#101317",
    panel="#171b21",
    raised="#222831",
    line="#2c343f",
    edge="#667384",
    text="#e9edf2",
    muted="#9eabba",
    accent="#58bfe6",
    accent_text="#06222e",
    good="#6ccf8e",
    fair="#f0b65a",
    bad="#ff8177",
)
NIGHT = Theme(
    "night",
    window="#000000",
    panel="#0a0000",
    raised="#220605",
    line="#4a120d",
    edge="#aa3a2d",
    text="#ff6a55",
    muted="#e05a4b",
    accent="#e8402c",
    accent_text="#000000",
    good="#e8402c",
    fair="#ff8a5c",
    bad="#ff5a48",
    canvas="#000000",
    canvas_text="#e05a4b",
    red=True,
)
"""Theme for a dark lab: only red on black, which affects dark-adapted eyes least."""

THEMES = {theme.name: theme for theme in (LIGHT, DARK, NIGHT)}

TYPE_COLOURS = ("#2a8fc4", "#d9772b", "#2aa37b")
"""Colours of the lens types, in both themes."""

_current = [LIGHT]


def current_theme() -> Theme:
    """Return the current theme."""
    return _current[0]


def canvas_fair() -> str:
    """Return the colour of a warning on the black background of a picture, from the dark or the red theme."""
    return (current_theme() if current_theme().red else DARK).fair


FONT_PT = 10.0

STYLED = "lfcal_styled"
"""Property of an application whose style is set: the name of its theme."""


def style_sheet() -> str:
    """Return the style sheet of the current theme.

    Set it on parts of a window, never on the application. That would also style thousands of widgets in plot menus
    that are never shown, which takes 2.5 s of processor time for each change.
    """
    return _sheet_of(current_theme())


@cache
def _sheet_of(theme: Theme) -> str:
    tick, arrow = (
        Path(__file__).with_name(f"{name}.svg").as_posix()
        for name in ("tick_white" if theme.accent_text == "#ffffff" else "tick_black", f"arrow_{theme.name}")
    )
    return _STYLE.format(**vars(theme), tick=tick, arrow=arrow)


@runtime_checkable
class Themed(Protocol):
    """A widget that draws with colours of the theme itself, because a style sheet does not apply to its drawing."""

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        ...


def _set_fields(palette: QPalette, theme: Theme) -> None:
    """Give spin boxes and lists the edge colour of ``theme``; Fusion draws edges 1.4 times darker than the window."""
    roles, off = QPalette.ColorRole, QPalette.ColorGroup.Disabled
    palette.setColor(roles.Window, QColor(theme.edge).lighter(140))
    palette.setColor(off, roles.Window, QColor(theme.line).lighter(140))
    for role in (roles.Base, roles.Button):
        palette.setColor(off, role, QColor(theme.window))
    for kind in ("QAbstractSpinBox", "QComboBox"):
        QApplication.setPalette(palette, kind)


def apply_theme(app: QApplication, theme: Theme) -> None:
    """Set the palette of the application to the palette of ``theme``; style sheets are set by windows and pages.

    Nothing is done if the theme is in use already.
    """
    _current[0] = theme
    styled = app.property(STYLED)
    if styled == theme.name:  # setting a palette again would update every widget
        return
    if not styled:  # takes a third of the time of a theme change
        app.setStyle("Fusion")
        font = app.font()
        font.setPointSizeF(FONT_PT)  # a rule of the style sheet for every widget is slow
        app.setFont(font)
    app.setProperty(STYLED, theme.name)
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
    off = QPalette.ColorGroup.Disabled
    for role in (roles.Text, roles.WindowText, roles.ButtonText):
        palette.setColor(off, role, QColor(theme.muted))
    app.setPalette(palette)
    _set_fields(palette, theme)
