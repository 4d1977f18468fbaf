"""How the site is made of `docs`: run by mkdocs, never installed.

- ``hooks``: what mkdocs calls
- ``running``: tutorials are run while the site is built; their output and figures are real
- ``reference``: pages of every public name, from the docstrings
- ``screens``: pictures of the workstation's pages
- ``speed``: the picture of the page on speed, drawn from its table by hand
- ``links``: every link and anchor of the built site leads somewhere
"""
