"""The acquire page."""
