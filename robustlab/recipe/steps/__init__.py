"""The kinds of steps, one file a field: each class says what a recipe may write and what is then done.

Beside them stand the contract of a step and the words that they share. The classes call the public functions of the
rooms below, choose the numbers that requirements may address, and draw; no mathematics lives here. A new kind is a
class marked with `robustlab.recipe.steps.contract.step`, in one of these files or in a new one; nothing else lists it.
"""

from importlib import import_module
from pathlib import Path

# The order of the kinds in the schema, and so a file imports only from those before it at its top; files that are not
# named here come last.
ORDER = ("models", "covers", "samples", "digital", "control", "records", "validation")

_found = sorted(path.stem for path in Path(__file__).parent.glob("[!_]*.py"))
for _name in sorted(_found, key=lambda name: ORDER.index(name) if name in ORDER else len(ORDER)):
    import_module(f"{__name__}.{_name}")

from robustlab.doors.declaration import ALL  # noqa: E402
from robustlab.recipe.steps.generated import add_steps  # noqa: E402

add_steps(*ALL)
