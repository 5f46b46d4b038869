"""Section III of the paper: features of one scan, boosting, loop closure, localisation."""
