"""Names of `lfcal_gui.widgets` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal_gui.widgets._axes import DecadeAxis, Plot
from lfcal_gui.widgets.axis_arrows import AxisArrows
from lfcal_gui.widgets.cards import (
    INSPECTOR,
    HeadedCard,
    VerdictCard,
    button,
    card,
    choice_box,
    clear,
    column_area,
    column_of,
    heading,
    inspector_width,
    line,
    row_of,
    scrolling,
    segment,
    split,
    told_or_shown,
    wrapped,
)
from lfcal_gui.widgets.colours import theme_table
from lfcal_gui.widgets.compare_panel import ComparedNumbers, ComparePanel
from lfcal_gui.widgets.contrast import Contrast
from lfcal_gui.widgets.cost_curve import CostCurve
from lfcal_gui.widgets.enlarging import toggle_in, whole_page
from lfcal_gui.widgets.folded_form import Folded, FoldedForm, add_chooser
from lfcal_gui.widgets.naming import name_controls
from lfcal_gui.widgets.period_map import PeriodMap
from lfcal_gui.widgets.picture import Picture, link, share_contrast
from lfcal_gui.widgets.picture_menu import offer_menu, table_entries
from lfcal_gui.widgets.plots import LINES, LinePlot, line_px, shown_tone
from lfcal_gui.widgets.rows_table import RowsTable
from lfcal_gui.widgets.status_panel import StatusPanel
from lfcal_gui.widgets.strip import PlaneTile, Strip, expected_apertures, legend_words, outline_tones
from lfcal_gui.widgets.words import ElidedLabel, WrappedLabel, lines_px, set_look, set_role
