"""Section III-A of the paper: boosted one-vs-all classifiers of features, and their JSON."""
