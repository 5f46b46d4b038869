"""The order of the stages, one pipeline a module, each on one screen, and what only they need."""
