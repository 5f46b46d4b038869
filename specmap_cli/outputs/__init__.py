"""What a run leaves behind: the map directory, its pictures and its tables."""
