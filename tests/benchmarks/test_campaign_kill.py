"""The small brother of benchmarks/campaign_kill.py: killed three times, and nothing to see of it in the result."""

from __future__ import annotations

import sys

import campaign_kill
import pytest


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds the workers in /proc")
def test_eight_hundred_samples_killed_three_times(tmp_path):
    found = campaign_kill.measure(tmp_path, samples=800, kills=3, gated=True, unbroken_workers=1)
    assert [text.split()[0] for text in found.kills] == ["main", "all", "main"]
    assert found.killed["digest"] == found.unbroken.digest
    assert found.killed["worst"] == found.unbroken.worst
    assert (found.killed["done"], found.killed["lost"], found.killed["status"]) == (800, 0, "converged")
    # Two workers: each kill of the main process costs at most the piece that each of them had in hand.
    assert max(found.redone_per_kill) <= 2
    assert len(found.redone_per_kill) == 3
    largest = max(last - first for first, last in found.pieces)
    assert 0 < found.redone_samples <= 3 * 2 * largest
