"""One page with every figure of one tree: its rows, how they are measured, and what got worse."""
