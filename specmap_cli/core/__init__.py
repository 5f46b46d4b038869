"""What all parts stand on: records, geometry, settings, errors, progress, text."""
