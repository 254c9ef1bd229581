"""The order of the test files: several processes share them, and the longest must not be the last to begin."""


def pytest_addoption(parser):
    parser.addoption("--update", action="store_true", help="write the transcripts of commands anew")


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
