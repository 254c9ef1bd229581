"""A second, small program that checks claims from their numbers alone, in exact and ball arithmetic."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "claim": "Blurred Claim Outcome Verification Work",
        "checker": "check",
        "files": "claims_in_file",
    },
)
