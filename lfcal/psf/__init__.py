"""The PSF matrix H."""
