"""Logs that are hard to map: sparse, without odometry, spoiled, very long, or from odd sensors."""
