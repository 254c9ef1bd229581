"""Lines of Python in each package may only decrease; tests import no inner module of a package.

``python tests/unit/house/test_size.py`` prints the current table. A change may lower a number, never raise one.
"""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
LIMITS = tomllib.loads(Path(__file__).with_name("sizes.toml").read_text())


def size(what: str) -> int:
    """Lines of all ``*.py`` below a folder of the repository."""
    return sum(len(path.read_bytes().splitlines()) for path in (ROOT / what).rglob("*.py"))


def test_tests_import_only_exported_names():
    """``from robustlab.norms import hinf_norm``, never ``from robustlab.norms.hinfinity import hinf_norm``."""
    deep = re.compile(r"^\s*from (robustlab(?:\.\w+){2,}) import", re.MULTILINE)
    found = [
        f"{path.relative_to(ROOT)}: {module}"
        for path in (ROOT / "tests").rglob("*.py")
        for module in deep.findall(path.read_text(encoding="utf-8"))
        if not (ROOT / module.replace(".", "/")).is_dir()
    ]
    assert found == []


@pytest.mark.parametrize("what", LIMITS)
def test_nothing_grows(what):
    assert size(what) <= LIMITS[what], f"{what} grew: take away as many elsewhere in it"


if __name__ == "__main__":
    for what in LIMITS:
        print(f'"{what}" = {size(what)}')
