"""One declaration, three interfaces: a command and a step offer the parameters of their function."""

import inspect
import subprocess
import sys
from typing import Any

import pytest

import robustlab as rl
from robustlab.cli import command_of
from robustlab.display import Displayable
from robustlab.errors import InputError, UsageError
from robustlab.operations import Choice, Numbers, Operation, Table, Thing, every_operation
from robustlab.recipe import KINDS, look_ahead

OPERATIONS = every_operation()
NAMES = [d.name for d in OPERATIONS]
# What only one operation can offer, and why.
ONE_WAY: dict[str, str] = {
    "expressions": "a recipe loads the set that the command wrote",
    "cover": "the members' envelope of a record, in recipes",
    "discretise_by_formula": "one line in Python",
    **dict.fromkeys(("show", "sample", "campaign", "resume", "read_campaign"), "of a command alone"),
    **dict.fromkeys(
        ("steady_state", "close_loop", "cascade", "join_clocks"), "one line in Python; recipes use the step"
    ),
    **dict.fromkeys(("data_cover", "with_loads", "tracking_problem", "feed_forward"), "of recipes"),
    **dict.fromkeys(("compare_performance", "follow_sine", "follow_path"), "of recipes"),
}


# Defaults of an operation that differ from Python's, and why.
OTHER_DEFAULTS = {
    ("sample", "vertices"): "a number, or all",
    **{(name, "starts"): "a command is waited for" for name in ("dk", "fixed_structure")},
}


@pytest.mark.parametrize("declared", OPERATIONS, ids=NAMES)
def test_every_capability_has_its_command_and_its_step(declared: Operation) -> None:
    name = declared.name
    assert (declared.command and declared.step) or name in ONE_WAY


@pytest.mark.parametrize("declared", OPERATIONS, ids=NAMES)
def test_names_defaults_and_help_are_those_of_the_declaration(declared: Operation) -> None:
    parameters = {p.name: p for p in declared.parameters}
    if declared.command:
        offered = inspect.signature(command_of(declared)).parameters
        for p in parameters.values():
            if p.kind.only != "step":
                option: Any = offered[p.name].annotation.__metadata__[0]
                assert option.help.startswith(p.help)
                assert p.help
                assert "robustlab." not in p.help  # a reference to another docstring
    if declared.step:
        keys = KINDS[declared.step].model_fields
        for p in parameters.values():
            if p.name != "seed" and p.kind.only != "command":
                assert keys[p.key].is_required() == (p.needed or p.kind.in_step is ...)
                default = p.default if p.kind.in_step is None else p.kind.in_step
                if not p.needed and isinstance(default, (int, float, str)):
                    assert keys[p.key].default == default


@pytest.mark.parametrize("declared", OPERATIONS, ids=NAMES)
def test_defaults_are_those_of_the_public_function(declared: Operation) -> None:
    function = getattr(rl, declared.name.rstrip("_"), None)
    if not callable(function):
        pytest.skip("an operation of more than one public function")
    known = inspect.signature(function).parameters
    for p in declared.parameters:
        public = known.get(p.name)
        if (declared.name, p.name) in OTHER_DEFAULTS:
            continue
        if public is not None and not p.needed and public.default not in (inspect.Parameter.empty, None, ()):
            assert p.default == public.default, p.name


@pytest.mark.parametrize("declared", OPERATIONS, ids=NAMES)
def test_a_result_is_displayed_by_all_readers(declared: Operation) -> None:
    kind = declared.result_classes[0]
    assert issubclass(kind, Displayable)
    for name in kind.quantities if kind.numbers is Displayable.numbers else ():
        assert hasattr(kind, name) or name in getattr(kind, "__dataclass_fields__", {}), name
    if declared.step:
        assert KINDS[declared.step].leaves == declared.quantities
        for name in kind.quantities:
            look_ahead(f"s.{name}", kind.quantities)


def test_families_declare_operations_without_numerical_libraries() -> None:
    code = "import sys, json\nfrom robustlab.operations import every_operation\nevery_operation()\n"
    code += "print(json.dumps([m for m in ('numpy', 'scipy', 'pydantic', 'matplotlib') if m in sys.modules]))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (Numbers("rad/s"), "1,x"),
        (Numbers("rad/s", 2, metavar="LOW,HIGH"), "1"),
        (Table(), ["a"]),
        (Table(), ["a=1", "a=2"]),
        (Choice(("a", "b")), "c"),
    ],
)
def test_wrong_words_of_a_command(kind: Any, text: Any) -> None:
    with pytest.raises((UsageError, InputError)):
        kind.read("--x", text)


def test_a_file_that_holds_another_kind_is_refused() -> None:
    with pytest.raises(InputError, match="an uncertain model"):
        Thing(("uncertain", "any")).as_wanted(rl.ss(-1.0, 1.0, 1.0, 0.0), "x.h5")
