"""What steps leave is held against what they declare, in every recipe that a test here runs in its own process."""

from collections.abc import Mapping
from fnmatch import fnmatchcase

import pytest

from robustlab.recipe import run
from robustlab.recipe.steps.leaves import with_signals
from robustlab.recipe.steps.proofs import with_verified


def undeclared(leaves, numbers, at):
    """Dotted names of what a step left though its pattern (`robustlab.recipe.steps.leaves`) does not tell of it."""
    if leaves is ... or numbers is None:
        return []
    if isinstance(numbers, Mapping) and isinstance(leaves, dict):
        found = []
        for name, value in numbers.items():
            fitting = [leaf for key, leaf in leaves.items() if key == name]
            fitting += [leaf for key, leaf in leaves.items() if "*" in key and fnmatchcase(name, key)]
            found += undeclared(fitting[0], value, f"{at}.{name}") if fitting else [f"{at}.{name}"]
        return found
    if isinstance(numbers, list) and isinstance(leaves, list):
        return [name for item in numbers[:3] for name in undeclared(leaves[0], item, f"{at}.0")]
    if isinstance(numbers, list) and isinstance(leaves, tuple):
        if len(numbers) != len(leaves):
            return [f"{at} has {len(numbers)} entries, {len(leaves)} are declared"]
        pairs = enumerate(zip(leaves, numbers, strict=True))
        return [name for i, (leaf, item) in pairs for name in undeclared(leaf, item, f"{at}.{i}")]
    if leaves in (bool, str):
        return [] if isinstance(numbers, leaves) else [f"{at} = {numbers!r}"]
    number = isinstance(numbers, (int, float)) or numbers in ("inf", "-inf", "nan")
    fits = number and not isinstance(numbers, bool) and not isinstance(leaves, (dict, list, tuple))
    return [] if fits else [f"{at} = {str(numbers)[:60]!r}"]


@pytest.fixture(scope="session", autouse=True)
def all_numbers_are_declared():
    real = run._run_steps

    def checked(loaded, workspace, report):
        for entry in real(loaded, workspace, report):
            name, step = entry["name"], loaded.recipe.step[entry["name"]]
            told = workspace.ahead[name].leaves
            leaves = with_signals(step.leaves if told is ... else told, None, None)  # as requirements read them
            leaves = with_verified(leaves, loaded.recipe.verify or step.verify)
            if leaves is not ... and type(step).run.__name__ == "run":  # not one that a test put in its place
                assert not undeclared({"status": str, **leaves}, entry["numbers"], name), step.kind
            yield entry

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "_run_steps", checked)
        yield
