"""The quality report: one HTML page with its pictures, and lists that programs read.

- ``write``: all of it into a folder
- ``page``: the page as text, ``style`` its look
- ``pictures``: every picture on it; ``parts``: what pages are made of; ``pdf``: the same on paper
- ``two``: two H compared
"""

from lfcal.psf.report.write import iter_report, redo_list, report, report_files

__all__ = ["iter_report", "redo_list", "report", "report_files"]
