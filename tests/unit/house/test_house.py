"""What the plan of the house promises, checked on the source."""

import ast
from pathlib import Path

import robustlab
from robustlab.uncertainty.blocks import KINDS

ROOT = Path(robustlab.__file__).parent
KIND_NAMES = {kind.__name__ for kind in KINDS.values()}


def kind_tests(source):
    """Lines that ask a block for its kind: isinstance, issubclass, a comparison of its type, a class pattern."""
    for node in ast.walk(ast.parse(source)):
        asks = isinstance(node, ast.Call) and getattr(node.func, "id", "") in {"isinstance", "issubclass"}
        if asks or isinstance(node, (ast.Compare, ast.MatchClass)):
            names = {getattr(n, "id", getattr(n, "attr", "")) for n in ast.walk(node)}
            if names & KIND_NAMES:
                yield getattr(node, "lineno", 0)


def test_no_module_outside_their_folder_asks_a_block_for_its_kind():
    folder = ROOT / "uncertainty" / "blocks"
    paths = [path for path in ROOT.rglob("*.py") if folder not in path.parents]
    found = {str(path.relative_to(ROOT)): list(kind_tests(path.read_text(encoding="utf-8"))) for path in paths}
    found = {path: lines for path, lines in found.items() if lines}
    assert not found, f"what differs between kinds belongs into the kind (robustlab/uncertainty/blocks): {found}"


def test_the_check_sees_what_it_looks_for():
    source = "isinstance(b, (RealScalar, int))\ntype(b) is blocks.FullBlock\nRealScalar('k')"
    assert list(kind_tests(source)) == [1, 2]
