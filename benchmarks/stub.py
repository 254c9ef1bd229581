"""Write ``robustlab/__init__.pyi``, what type checkers read, from the table of public names in ``__init__.py``.

python benchmarks/stub.py
"""

from __future__ import annotations

from pathlib import Path

import robustlab

STUB = Path(robustlab.__file__).with_suffix(".pyi")


def stub_text() -> str:
    table = robustlab._PUBLIC
    by_module = sorted((module, name) for name, module in table.items())
    lines = [
        "# Written by benchmarks/stub.py from the table in __init__.py; do not edit.",
        *(f"from robustlab.{module} import {name} as {name}" for module, name in by_module),
        "",
        "__version__: str",
        "__all__ = [",
        *(f'    "{name}",' for name in table),
        "]",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    STUB.write_text(stub_text(), encoding="utf-8")
