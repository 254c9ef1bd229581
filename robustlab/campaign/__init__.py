"""Campaigns: samples and worst-case searches of any size, in worker processes here or on many machines.

Each sample is stored as it comes; a run that was interrupted or killed goes on where it was, to the same result.
"""

from robustlab.campaign.campaign_result import CampaignResult
from robustlab.campaign.runs import (
    Replay,
    read_campaign,
    replay_sample,
    resume_campaign,
    run_campaign,
    saved_samples,
)
from robustlab.campaign.settings import CampaignSettings
from robustlab.campaign.workers import Crew

__all__ = [
    "CampaignResult",
    "CampaignSettings",
    "Crew",
    "Replay",
    "read_campaign",
    "replay_sample",
    "resume_campaign",
    "run_campaign",
    "saved_samples",
]
