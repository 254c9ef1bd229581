"""The evidence of results as claims that `robustlab.verify` checks from the numbers alone.

`claims_of` returns the claims of a result, by its method ``claims`` or a row of ``CLAIMS``; `verify` checks them.
"""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "verification": "Verified claims_of verify",
        "claims": "h2_claims hinf_claims",
    },
)
