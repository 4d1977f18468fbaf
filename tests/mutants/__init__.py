"""Mutants: one small mistake is put into the sources at a time, and the tests that mirror its file must see it.

    python -m tests.mutants                     # 60 mutants of seed 1, the table into tests/mutants/TABLE.md

- ``operators``: the mistakes, and where in a file they can be made
- ``choosing``: which files have tests of their own, and a seeded choice of mutants among them
- ``running``: a copy of the tree, in which a mutant lives while its tests run
- ``page``: the table of what became of them
"""
