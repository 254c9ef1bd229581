"""The command line: it parses, calls and prints, and contains no mathematics."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "completion": "PLANTS",
        "console": "Display main_guard",
        "main": "GROUPS help_text parser run_command",
        "generated": "command_of",
    },
)
