"""The evidence of results as claims that `robustlab.verify` checks from the numbers alone.

`claims_of` turns a result into claims; `verify` has them judged. What a class claims is said by its
method ``claims``, or in one row of ``CLAIMS``.
"""

from robustlab.lazily import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "verification": "Verified claims_of verify",
        "designs": "h2_claims hinf_claims",
    },
)
