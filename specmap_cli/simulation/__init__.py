"""Simulated recordings: worlds of floor plans, tours, lasers and odometry with errors."""
