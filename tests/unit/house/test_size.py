"""What may only go down: lines of Python in each package, and imports of tests from inside of packages.

``python tests/unit/house/test_size.py`` prints the table as it is now. A change may lower a number, never raise one.
"""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
LIMITS = tomllib.loads(Path(__file__).with_name("sizes.toml").read_text())
DEEP = "imports of tests from inside of packages"


def size(what: str) -> int:
    """Lines of all ``*.py`` below a folder of the repository; of `DEEP` the number of such imports."""
    files = (ROOT / ("tests" if what == DEEP else what)).rglob("*.py")
    if what == DEEP:
        return sum(len(re.findall(r"^\s*from robustlab\.\w+\.\w", path.read_text(), re.M)) for path in files)
    return sum(len(path.read_bytes().splitlines()) for path in files)


@pytest.mark.parametrize("what", LIMITS)
def test_nothing_grows(what):
    assert size(what) <= LIMITS[what], f"{what} grew: take away as many elsewhere in it"


if __name__ == "__main__":
    for what in LIMITS:
        print(f'"{what}" = {size(what)}')
