"""Rules that a finished map must keep: what is measured, what it may be, and who is told."""
