"""The layout: one consistent pose a keyframe, by a pose graph of motion and loop closures."""
