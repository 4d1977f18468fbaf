"""The reconstruct page."""
