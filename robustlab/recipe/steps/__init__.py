"""The kinds of steps: classes marked with `contract.step` in the files here, and those made of operations."""

from importlib import import_module
from pathlib import Path

# The order of the kinds in the schema; a file imports only from those before it. Other files come last.
ORDER = ("models", "covers", "samples", "control", "records", "validation")

_found = sorted(path.stem for path in Path(__file__).parent.glob("[!_]*.py"))
for _name in sorted(_found, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER)):
    import_module(f"{__name__}.{_name}")

from robustlab.recipe.steps.generated import add_steps  # noqa: E402

add_steps()
