"""The map directory: its schema, written complete or not at all, checked when read."""
