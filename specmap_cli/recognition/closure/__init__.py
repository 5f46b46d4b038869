"""Section III-C of the paper: claims between submaps, the match of their grids, loop closures."""
