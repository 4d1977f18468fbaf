"""How the site is made of `docs`: run by mkdocs, never installed.

- ``hooks``: what mkdocs calls
- ``running``: tutorials are run while the site is built; their output and figures are real
- ``reference``: pages of every public name, from the docstrings
- ``tables``: tables made from registries, and every option of every command
- ``schemas``: the JSON Schemas of camera, plan and session, made from their records when called
- ``screens``: pictures of the workstation's pages
- ``speed``: the picture of the section on speed, drawn from its table when called
- ``links``: every link and anchor of the built site leads somewhere
"""
