"""What the recipes say of measured machines: every requirement, met or not, and the time.

python benchmarks/real_records.py hsm150 emps-discover    (all five without names)
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from robustlab.recipe.load import load_recipe, recipe_path
from robustlab.recipe.run import run_recipe

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FILES = {
    "emps-discover": "emps.h5",
    "hsm150": "hsm150_torque_steps.h5",
    "rack-pinion": "rack_pinion_friction.h5",
    "cascaded-tanks": "cascaded_tanks.h5",
    "coupled-drives": "ced.h5",
}


def main(names: list[str]) -> None:
    """Run and print."""
    for name in names or list(FILES):
        recipe = load_recipe(recipe_path(name)).recipe
        at = [f"{step}.path={DATA / FILES[name]}" for step, s in recipe.step.items() if s.kind == "record"]
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            result = run_recipe(load_recipe(recipe_path(name), at), Path(folder) / "out").data
        print(f"\n{name}: {time.perf_counter() - began:.0f} s")
        for step in result["steps"]:
            if "verdict" in step["numbers"]:
                said = step["numbers"]
                print(f"  {step['name']}: {said['verdict']} {said['names']}, may be {said['answer']}")
        for q in result["requirements"]:
            print(f"  {'met ' if q['met'] else 'MISS'} {q['text']}: {q['why_not'] or q['value']}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
