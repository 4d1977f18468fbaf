"""The quality report: one HTML page with its pictures, and lists that programs read.

- ``page``: the page as text, from ``style`` and ``sections``
- ``pictures``: every picture on it
- ``write``: all of it into a folder
"""
