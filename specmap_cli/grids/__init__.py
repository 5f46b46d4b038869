"""Occupancy grids: integrated, cast in, matched, read and written; the store of keyframes."""
