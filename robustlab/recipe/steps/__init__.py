"""The kinds of steps: classes marked with `contract.step` in the files here, and those made of operations."""

from robustlab.recipe.steps import models, records, samples, validation  # noqa: F401  they register their steps
from robustlab.recipe.steps.generated import add_steps

add_steps()
