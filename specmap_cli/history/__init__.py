"""Maps of many days: which rooms were visited how often, and what changed when."""
