"""Operations: each is declared once, for the command line and for recipes."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "declaration": "COMMANDS Operation STEPS every_operation reading_option",
        "kinds": "Choice Numbers Table Thing",
        "members": "METRICS",
        "models": "COVERS elementwise",
    },
)
