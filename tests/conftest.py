"""The order of the test files, and the examples that hypothesis draws."""

import os

from hypothesis import settings

# The same examples in every run, so that a failure is due to the change; HYPOTHESIS_PROFILE=search draws new ones.
settings.register_profile("repeat", derandomize=True, deadline=None)
settings.register_profile("search", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeat"))


def pytest_addoption(parser):
    parser.addoption("--update", action="store_true", help="write the transcripts of commands anew")


# Several processes share the files; the longest must not be the last to begin.
LONGEST_FIRST = (
    "test_recipe_emps.py",
    "test_recipe_real_records.py",
    "test_readme.py",
    "test_recipe_shipped.py",
    "test_discover_subset.py",
    "test_recipe_chapter_11.py",
    "test_recipe_thesis.py",
    "test_storage_round_trip.py",
    "test_mu_bounds_hold.py",
    "test_recipe_thesis_worst_cases.py",
    "test_cli_data_discover.py",
)
RANK = {name: rank for rank, name in enumerate(LONGEST_FIRST)}


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: RANK.get(item.path.name, len(RANK)))
