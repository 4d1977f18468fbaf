"""The simulate page."""
