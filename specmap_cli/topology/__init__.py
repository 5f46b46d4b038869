"""The graph of submaps, and the layout of their frames."""
