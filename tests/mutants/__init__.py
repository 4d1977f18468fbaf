"""Mutants: one small mistake at a time is put into the sources, and the tests that belong to the file must fail.

    python -m tests.mutants                     # 60 new mutants, the table into tests/mutants/TABLE.md

- ``operators``: the kinds of mistakes, and where a file allows them
- ``choosing``: the tests that belong to a file, and a random choice of mutants
- ``running``: a copy of the tree that contains one mutant while its tests run
- ``page``: the table of outcomes
"""
