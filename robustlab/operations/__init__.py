"""One declaration of a capability: what a command and a step of recipes offer of a function of Python."""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "declaration": "ALL COMMANDS Operation STEPS every_operation reading_option",
        "kinds": "Choice Numbers Table Thing Whole",
        "members": "METRICS",
        "sets": "COVERS elementwise",
        "vocabulary": "Positive ToModel",
    },
)
