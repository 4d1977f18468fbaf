"""Pieces of pages: images with axes and colour bar, plots, forms from dataclasses, the status area."""
