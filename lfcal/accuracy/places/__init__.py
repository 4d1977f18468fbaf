"""The places where accuracy is paid, a module each with its ``PLACE``.

A place is found by `lfcal.accuracy.place`: adding one is adding a module here, or an entry point of the group
``lfcal.accuracy`` in another distribution (``docs/extending.md``).
"""
