"""The command line: one file per command group; it parses, calls and prints, and contains no mathematics."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "console": "Display",
        "exit_codes": "main_guard",
        "groups": "GROUPS parser",
        "main": "help_text run_command",
        "completion": "PLANTS",
        "generated": "command_of",
    },
)
