"""The command line: one file per command group; it parses, calls and prints, and contains no mathematics."""

# What was typed behind ``robustlab``, for commands that answer with the same command and more; set in `main`.
TYPED: list[str] = []
