"""Campaigns: samples and searches of any size in worker processes; an interrupted run is resumed to the same result."""

from robustlab.campaign.campaign_result import CampaignResult
from robustlab.campaign.evaluation import TILE, CampaignSettings, Evaluator, Identity, Rows
from robustlab.campaign.runs import (
    Crew,
    read_campaign,
    resume_campaign,
    run_campaign,
    saved_samples,
)
from robustlab.campaign.store import Store

__all__ = [
    "TILE",
    "CampaignResult",
    "CampaignSettings",
    "Crew",
    "Evaluator",
    "Identity",
    "Rows",
    "Store",
    "read_campaign",
    "resume_campaign",
    "run_campaign",
    "saved_samples",
]
