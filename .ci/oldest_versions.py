"""Print the oldest versions that pyproject.toml allows, one ``name==version`` a line: constraints for pip.

``python .ci/oldest_versions.py [extra ...] > constraints.txt``: what the package needs, and what those extras add.
"""

import re
import sys
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
LOWER_BOUND = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(\[[^\]]*\])?\s*>=\s*(?P<version>[0-9][0-9A-Za-z.]*)")


def oldest(requirements: list[str]) -> list[str]:
    """``name==version`` of each requirement's lower bound; a requirement without one is an error."""
    found = []
    for requirement in requirements:
        match = LOWER_BOUND.match(requirement)
        if match is None:
            sys.exit(f"{PROJECT}: {requirement!r} has no lower bound, expected name>=version")
        found.append(f"{match['name']}=={match['version']}")
    return found


if __name__ == "__main__":
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extras = [project["optional-dependencies"][name] for name in sys.argv[1:]]
    print("\n".join(oldest(sum(extras, project["dependencies"]))))
