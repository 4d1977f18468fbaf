"""Mutants: small mistakes, made one at a time in the sources, for which the tests of the file must fail.

    python -m tests.mutants                     # 60 new mutants, and their table in tests/mutants/TABLE.md

- ``operators``: the kinds of mistakes, and the places in a file where they can be made
- ``choosing``: the tests that belong to a file, and a random choice of mutants
- ``running``: a copy of the tree that contains one mutant while its tests run
- ``page``: the table of outcomes
"""
