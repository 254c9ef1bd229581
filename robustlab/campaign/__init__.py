"""Campaigns: samples and searches of any size in worker processes; an interrupted run is resumed to the same result."""

from robustlab.public_names import lazily

__all__, __getattr__ = lazily(
    __name__,
    {
        "evaluation": "TILE CampaignSettings Evaluator Identity Rows",
        "runs": "CampaignResult WorkerOptions read_campaign resume_campaign run_campaign saved_samples",
        "store": "Store",
    },
)
