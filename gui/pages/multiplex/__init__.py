"""The multiplex page."""
