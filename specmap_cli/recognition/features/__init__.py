"""Section III-B of the paper: rotation-invariant features of one scan, in named sets."""
