"""Compare the numbers of steps with their declarations, in every recipe that a test here runs in its own process."""

from collections.abc import Mapping

import pytest

from robustlab.errors import InputError
from robustlab.recipe import look_ahead, run


def undeclared(numbers, leaves, path):
    """Dotted names of what a step left though it does not declare them."""
    found = []
    for name, value in numbers.items() if isinstance(numbers, Mapping) else ():
        if "." in name:  # no path leads there
            continue
        try:
            look_ahead(f"{path}.{name}", leaves)
        except InputError:
            found.append(f"{path}.{name}")
            continue
        found += undeclared(value, leaves, f"{path}.{name}")
    return found


@pytest.fixture(scope="session", autouse=True)
def all_numbers_are_declared():
    real = run._run_steps

    def checked(loaded, workspace, report):
        for entry in real(loaded, workspace, report):
            name, step = entry["name"], loaded.recipe.step[entry["name"]]
            leaves = workspace.ahead[name].leaves
            leaves = step.leaves if leaves is ... else leaves
            if leaves is not ... and type(step).run.__name__ == "run":  # not one that a test put in its place
                assert not undeclared(entry["numbers"], {"status": str, "verified": bool, **leaves}, name), step.kind
            yield entry

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "_run_steps", checked)
        yield
