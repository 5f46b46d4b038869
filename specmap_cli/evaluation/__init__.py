"""Simulated logs, scores and protocols."""
