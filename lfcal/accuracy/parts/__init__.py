"""Parts of the processing whose accuracy can be chosen, one module each with its ``PART``.

They are found by `lfcal.accuracy.part`. To add one, add a module here, or an entry point of the group
``lfcal.accuracy`` in another package (``docs/extending.md``).
"""
