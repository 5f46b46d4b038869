"""Section II of the paper: free space into submaps by spectral clustering."""
