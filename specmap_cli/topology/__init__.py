"""The graph of submaps: which keyframes, cells and edges belong to each, and their outlines."""
