"""Finished maps in the formats of other tools: one module a format, behind one table."""
