"""Whatever a recipe file holds, it is a recipe or one clear `InputError`; nothing else comes out of the loader.

Recipes with bytes flipped, cut and put in are in tests/faults/test_files_fuzz.py.
"""

from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robustlab.errors import InputError, UsageError
from robustlab.recipe import Recipe, parse_recipe

FIRST_LIGHT = (Path(__file__).parents[2] / "recipes" / "first-light.toml").read_text(encoding="utf-8")
LINES = FIRST_LIGHT.splitlines()

toml_values = st.recursive(
    st.one_of(
        st.sampled_from(
            ["1", "-1", "1e400", "nan", "inf", "true", "[]", "{}", "1979-05-27", '""', "'x'", "0x7f", "[[]]"]
        ),
        st.text(st.characters(codec="utf-8"), max_size=8).map(lambda t: f"'''{t}'''"),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(lambda v: f"[{', '.join(v)}]"),
        st.dictionaries(st.sampled_from(["a", "num", "value", "output"]), inner, max_size=2).map(
            lambda d: "{" + ", ".join(f"{k} = {v}" for k, v in d.items()) + "}"
        ),
    ),
    max_leaves=4,
)


def message_of(text: str, **overrides: str) -> str:
    """Return the message of the loader; "" if it accepts the text as a recipe."""
    try:
        return "" if isinstance(parse_recipe(text, "r.toml", overrides), Recipe) else "no recipe"
    except (InputError, UsageError) as error:
        return str(error)


def check(message: str) -> None:
    assert not message or message.startswith(("r.toml", "--set"))
    assert all(ch.isprintable() or ch == "\n" for ch in message)


@pytest.mark.parametrize("text", ["a.b.c = 1\n[a]\nb = 2", "\x00"])
def test_what_is_no_toml(text):
    check(message_of(text))


@given(st.integers(0, len(LINES) - 1), toml_values)
@settings(max_examples=50)
def test_a_real_recipe_with_one_value_replaced(index, value):
    lines = LINES.copy()
    key, equals, _ = lines[index].partition("=")
    lines[index] = f"{key}= {value}" if equals else value
    check(message_of("\n".join(lines)))


@given(
    st.text(st.characters(codec="utf-8"), min_size=1, max_size=20), st.text(st.characters(codec="utf-8"), max_size=20)
)
@settings(max_examples=50)
@example("step.motor", "{}")
@example("step", "3")
@example("motor.parameters.R.x", "1")
@example("require.99.text", "x")
def test_any_override(key, value):
    check(message_of(FIRST_LIGHT, **{key: value}))
