"""One folder per page, all with the same layout; pages never import each other.

- ``__init__``: ``PAGE``, a `lfcal_gui.models.page.PageSpec`: title, place in the rail, state, icon; imports no Qt
- ``page``: ``Page``, a `lfcal_gui.base_page.BasePage` that connects project, jobs and panel
- ``panel``: the widgets; they show display records and emit what the user asked for
- ``model``, ``model_*``: pure functions and frozen records; no Qt

`lfcal_gui.models.page.PAGES` finds them; docs/extending.md shows a complete one.
"""
