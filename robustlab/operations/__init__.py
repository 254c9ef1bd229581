"""Operations: each is declared once, for the command line and for recipes."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "declaration": "COMMANDS Operation STEPS every_operation reading_option",
        "parameter_types": "Choice Numbers Table Thing",
        "worst_cases": "METRICS",
        "models": "COVERS elementwise",
    },
)
