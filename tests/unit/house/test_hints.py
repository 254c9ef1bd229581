"""Hints of errors: stored in Python syntax, shown in that of the interface in use."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import robustlab as rl
from robustlab.cli import main, main_guard
from robustlab.errors import rewritten
from robustlab.operations import COMMANDS, STEPS, reading_option
from robustlab.recipe import steps  # loads the registry

ROOT = Path(rl.__file__).parent
RAISED = {"InputError", "UsageError", "NoTrustworthyNumber", "EnvironmentFault", "UnitMismatch"}
# Files of the command line, of stores that it alone makes, and of recipes, whose files it alone runs.
assert steps.BASES
COMMAND_ONLY = ("cli", "campaign", "recipe")


def texts(node: ast.AST) -> Iterator[str]:
    """All texts in an expression; what is filled in is ``{'x': 1.0}`` where braces are, else ``'x'``."""
    if isinstance(node, ast.JoinedStr):
        yield "".join(v.value if isinstance(v, ast.Constant) else "'x'" for v in node.values)  # pyright: ignore
    elif isinstance(node, ast.Constant):
        yield from [node.value] if isinstance(node.value, str) else []
    else:
        for part in ast.iter_child_nodes(node):
            yield from texts(part)


def hints() -> Iterator[tuple[str, str]]:
    """Every hint in the package with the file that it is in."""
    for path in sorted(ROOT.rglob("*.py")):
        if path.relative_to(ROOT).parts[0] in COMMAND_ONLY:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            given: list[ast.expr] = []
            if isinstance(node, ast.Call):
                given = [k.value for k in node.keywords if k.arg == "hint"]
                if getattr(node.func, "id", "") in RAISED:
                    given += node.args[3:4]
            elif isinstance(node, ast.Assign) and any("hint" in ast.unparse(to) for to in node.targets):
                given = [node.value]
            yield from ((path.name, text) for expression in given for text in texts(expression))


def test_every_hint_is_in_the_syntax_of_its_interface():
    operations = [*dict.fromkeys([*COMMANDS.values(), *STEPS.values()])]
    seen = 0
    for file, hint in hints():
        assert not re.search(r"(?<![\w-])--[a-z]", re.sub(r"(dask|pip|robustlab) .*", "", hint)), (file, hint)
        arguments: list[str] = []
        rewritten(hint, lambda name, _, found=arguments: found.append(name))
        for operation in operations if arguments else ():
            names = {n: p for p in operation.parameters for n in (p.kind.argument or p.name, p.key)}
            for p in (names[name] for name in arguments if name in names):
                seen += 1
                assert p.options[0] in operation.hint(hint, of_command=True), (file, hint)
                assert f"{p.key} = " in operation.hint(hint, of_command=False), (file, hint)
    assert seen > 20


@pytest.mark.parametrize(
    ("hint", "command", "step"),
    [
        ("say u={'y1': 1.0}", "say --input-value y1=1.0", "say input = { y1 = 1.0 }"),
        ("output='y1'", "--outputs y1", 'output = "y1"'),
        ("rl.load(path, output='y1')", "rl.load(path, output='y1')", "rl.load(path, output='y1')"),
    ],
)
def test_a_hint_in_three_syntaxes(hint, command, step):
    operation = COMMANDS["worst-case"]
    assert operation.hint(hint, of_command=True) == command
    assert operation.hint(hint, of_command=False) == step
    assert rewritten("transpose=True", reading_option) == "--transpose"


def test_the_missing_input_of_a_step_is_reported_in_each_interface(tmp_path, monkeypatch, capsys):
    """One input gets a unit step, as in the help; for two the hint shows how to choose."""
    monkeypatch.chdir(tmp_path)
    rows = [[0, 0, 0], [0, 0, 0]]
    M = rl.StateSpaceModel([[-1.0]], [[0.4, 1, 1]], [[1], [1]], rows, inputs=["w", "r", "d"], outputs=["z", "y"])
    loop = rl.UncertainModel(M, [rl.RealScalar("k")])
    rl.save("loop.h5", loop)
    with pytest.raises(rl.InputError, match=r"hint: say which input steps: u=\{'r': 1\.0\}"):
        rl.worst_case(loop, "peak-deviation", output="y")
    call = ["worst-case", "loop.h5", "--metric", "peak-deviation", "--outputs", "y", "--t-end", "6"]
    assert main_guard(lambda: main.run_command(call)) == 3
    assert "hint: say which input steps: --input-value r=1.0\n" in capsys.readouterr().err
    assert main.run_command([*call, "--input-value", "r=1.0"]) == 0
    step = 'of = "set"\nmetric = "peak-deviation"\noutput = "y"\nt_end = 6.0\n'
    Path("r.toml").write_text(
        'schema = "robustlab.recipe/1"\nname = "r"\n[step.set]\ndo = "load"\npath = "loop.h5"\n'
        f'[step.worst]\ndo = "worst-case"\n{step}'
    )
    assert main_guard(lambda: main.run_command(["run", "r.toml", "--out", "o"])) == 3
    assert "hint: say which input steps: input = { r = 1.0 }" in capsys.readouterr().err
