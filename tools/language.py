"""Count words of the project's former private dialect: ``python tools/language.py``; exit code 1 above the budget.

A smoke alarm, not the standard. The standard is that an engineer reads a page once (CONTRIBUTING.md).
"""

import re
import sys
from collections import Counter
from pathlib import Path

BUDGET = 40
DIALECT = re.compile(
    r"\b(?:told|tells?|said|asked|beside|stands|lies|hears|of ours|somebody's|leaves open|left to chance|gives way)\b"
    r"|(?:^|[.:;] )What (?:[a-z]+ ){1,5}(?:is|are|has|can|may|must|does|was)\b(?![^.]*\?)",
    re.MULTILINE,
)
ROOT = Path(__file__).parents[1]
FOLDERS = ("robustlab", "docs", "recipes", "models", "tests", "benchmarks")
SUFFIXES = (".py", ".md", ".toml", ".jinja")


def main() -> int:
    """Print the number of words, above the budget with their files, and return the exit code."""
    files = [*ROOT.glob("*.md"), *(f for folder in FOLDERS for f in (ROOT / folder).rglob("*"))]
    found = {
        file.relative_to(ROOT): Counter(DIALECT.findall(file.read_text(encoding="utf-8")))
        for file in files
        if file.suffix in SUFFIXES and "results" not in file.parts
    }
    total = sum(words.total() for words in found.values())
    for name, words in sorted(found.items(), key=lambda item: -item[1].total()) if total > BUDGET else ():
        if words:
            print(f"{words.total():4} {name}: {', '.join(f'{w.strip()} {n}' for w, n in words.most_common())}")
    print(f"{total} words of the dialect, budget {BUDGET}")
    return int(total > BUDGET)


if __name__ == "__main__":
    sys.exit(main())
