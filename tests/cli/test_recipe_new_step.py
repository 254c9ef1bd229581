"""A new kind of step is one class with a decorator: recipes check it, run it, and the schema contains it."""

from typing import ClassVar, Literal

import pytest
from pydantic import Field

from robustlab.errors import InputError
from robustlab.recipe import (
    KINDS,
    Fact,
    Outcome,
    Positive,
    Step,
    ToModel,
    Workspace,
    json_schema,
    load_recipe,
    parse_recipe,
    run_recipe,
    step,
)

RECIPE = """\
schema = "robustlab.recipe/1"
name = "doubled"

[step.motor]
do = "plant"
plant = "dc-motor"

[step.model]
do = "linearise"
of = "motor"
outputs = ["omega"]

[step.gain]
do = "dc-gain"
of = "model"
factor = 2.0

[[require]]
text = "Twice the gain of 18.5 rad/s per volt"
that = "gain.value"
at_least = 30.0
"""


@pytest.fixture(autouse=True)
def dc_gain():
    """The new step, known to this test alone."""
    before = dict(KINDS)

    @step
    class DcGainStep(Step):
        """The gain of a model at frequency zero."""

        gives: ClassVar[str] = "number"
        do: Literal["dc-gain"]
        of: ToModel
        factor: Positive = Field(1.0, description="On the gain.")

        def run(self, work: Workspace) -> Outcome:
            value = self.factor * float(work.values[self.of].dc_gain()[0, 0])
            return Outcome(value, f"Gain of {self.of}.", {"value": value}, (Fact("Gain", f"{value:.4g}"),))

    yield
    KINDS.clear()
    KINDS.update(before)


def test_a_recipe_with_it_runs(tmp_path):
    file = tmp_path / "doubled.toml"
    file.write_text(RECIPE)
    result = run_recipe(load_recipe(file), tmp_path / "out")
    assert result.exit_code == 0
    last = result.data["steps"][-1]
    assert (last["do"], last["facts"][0]["label"]) == ("dc-gain", "Gain")
    assert last["numbers"]["value"] > 30


def test_the_schema_and_the_checker_know_it():
    schema = json_schema()
    assert schema["$defs"]["DcGainStep"]["properties"]["factor"]["description"] == "On the gain."
    assert "DcGainStep" in str(schema["properties"]["step"])
    with pytest.raises(InputError, match=r"one of plant, .*, thesis-case, .*, dc-gain"):
        parse_recipe(RECIPE.replace('"dc-gain"', '"gain"'))
    with pytest.raises(InputError, match=r"step\.gain\.factr: unknown key \(did you mean factor\?\)"):
        parse_recipe(RECIPE.replace("factor =", "factr ="))
