"""The kinds of steps: classes marked with `contract.step` in the files here, and those made of operations."""

from importlib import import_module

for _name in ("models", "records", "samples", "validation"):
    import_module(f"{__name__}.{_name}")

from robustlab.recipe.steps.generated import add_steps  # noqa: E402

add_steps()
