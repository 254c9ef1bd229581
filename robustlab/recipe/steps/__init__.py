"""The kinds of steps: classes marked with `contract.step`, and those made of operations."""

from robustlab.recipe.steps.by_hand import BASES
from robustlab.recipe.steps.generated import add_steps

add_steps(BASES)
