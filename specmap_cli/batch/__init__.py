"""Many jobs of many logs: what describes them, and what a worker does with one of them."""
