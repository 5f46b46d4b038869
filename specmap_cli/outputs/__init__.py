"""Writing and reading map directories, pictures and exports."""
