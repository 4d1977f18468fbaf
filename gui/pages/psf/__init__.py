"""The psf page."""
