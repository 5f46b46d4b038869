"""The paper by one command: its tables and figures, computed and put on one page."""
