"""What a run shows: figures, a self-contained HTML page, a JUnit file."""
