"""Scripts that build the site from `docs`; mkdocs runs them, and they are not installed.

- ``hooks``: functions that mkdocs calls
- ``running``: runs the tutorials while the site is built, so their output and figures are real
- ``reference``: pages of all public names, from the docstrings
- ``tables``: tables from registries, and of all options of all commands
- ``schemas``: JSON Schemas of camera, plan and session, made from their records when run
- ``screens``: pictures of the pages of the window
- ``speed``: figure of the section on speed, drawn from its table when run
- ``links``: check of all links and anchors of the built site
"""
