"""Lines of Python that each package may have. A change may lower a number of sizes.toml, never raise one.

``python tests/unit/house/test_size.py`` prints the table as it is now.
"""

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
LIMITS = tomllib.loads(Path(__file__).with_name("sizes.toml").read_text())


def lines(folder: str) -> int:
    """Lines of all ``*.py`` below a folder of the repository."""
    return sum(len(path.read_bytes().splitlines()) for path in (ROOT / folder).rglob("*.py"))


@pytest.mark.parametrize("folder", LIMITS)
def test_a_package_has_no_more_lines_than_it_may(folder):
    assert lines(folder) <= LIMITS[folder], f"{folder} grew: delete as many lines elsewhere in it"


if __name__ == "__main__":
    for folder in LIMITS:
        print(f'"{folder}" = {lines(folder)}')
