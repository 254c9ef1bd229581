"""Campaigns: samples and worst-case searches of any size, in worker processes on one or many machines.

Each sample is stored when computed; an interrupted or killed run can be resumed, with the same result.
"""

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
