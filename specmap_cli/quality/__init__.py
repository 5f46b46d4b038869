"""The verdict on a map: findings of the stages, weighed together."""
