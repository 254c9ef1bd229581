"""The recipes of the thesis and of the platform's models run and meet their requirements."""

from pathlib import Path

import numpy as np
import pytest
from recipe_runs import unmet

import robustlab as rl
from robustlab.recipe import load_recipe, recipe_path, run_recipe

ROOT = Path(__file__).parents[2]
CHAPTER_11, REQUIREMENTS = "# --- chapter 11:", "# --- requirements"


@pytest.mark.slow
def test_thesis_meets_its_requirements(tmp_path):
    """Without the comparisons of chapter 11, whose kind of step first-light tests: they would take half a minute."""
    text = load_recipe(recipe_path("thesis")).text
    short = tmp_path / "thesis.toml"
    short.write_text(text[: text.index(CHAPTER_11)] + text[text.index(REQUIREMENTS) :], encoding="utf-8")
    result = run_recipe(load_recipe(short, ["numbers.n=4"]), tmp_path / "out")
    assert unmet(result) == set()
    assert result.exit_code == 0
    (step,) = [s for s in result.data["steps"] if s["name"] == "numbers"]
    judged = {q["that"] for q in result.data["requirements"]}
    rows = step["numbers"]["rows"]
    assert {f"numbers.rows.{key}.ours" for key, row in rows.items() if row["status"] in "RF"} <= judged
    # Fits are counted by themselves.
    assert step["numbers"]["counts"] == {"R": 21, "F": 2, "P": 23, "N": 16}
    assert "21 of 21 declared reproducible are; 2 more are fits" in step["summary"]
    # One number for a case, in the table and in its figure.
    for key, case in (("15", "1"), ("16", "2a"), ("17", "2b"), ("18", "2c")):
        assert step["numbers"]["bands"][case]["phi_1"] == pytest.approx(rows[key]["ours"], rel=1e-8)
    captions = {f["stem"]: f["caption"] for f in step["figures"]}
    drawn = {f"numbers-{kind}-{run}" for kind in ("path", "error") for run in ("thesis", "link-4", "rotors")}
    sines = ("0_1_N_m_at_2_Hz", "1_mN_m_at_2_Hz", "0_1_N_m_at_20_Hz")
    drawn |= {f"numbers-sine-{run}" for run in sines} | {f"numbers-case-{case}" for case in ("1", "2a", "2b", "2c")}
    assert set(captions) == drawn
    for stem in captions:
        assert (result.folder / f"figures/{stem}.svg").stat().st_size > 5_000
    assert "worst Δ = +I" in captions["numbers-case-1"]
    assert all("worst Δ = -I" in captions[f"numbers-case-{case}"] for case in ("2a", "2b", "2c"))
    assert "figures 8.1, 8.2" in captions[f"numbers-sine-{sines[0]}"]
    assert "figures 9.3-9.5" in captions["numbers-path-thesis"]
    page = (result.folder / "report.html").read_text(encoding="utf-8")
    assert "not reproducible from the text" in page
    assert rl.load(result.folder / "evidence/numbers.h5").status is rl.Status.CONVERGED


def test_the_committed_platform_models_are_those_of_their_recipe(tmp_path):
    result = run_recipe(load_recipe(recipe_path("platform-models")), tmp_path / "out")
    assert result.exit_code == 0
    for name in ("platform_nominal.h5", "platform_low.h5"):
        made, committed = rl.load(result.folder / name), rl.load(ROOT / "models" / name)
        assert made.output_names == committed.output_names
        for matrix in "ABCD":  # compiled code may round differently elsewhere
            size = np.abs(getattr(made, matrix)).max()
            np.testing.assert_allclose(getattr(made, matrix), getattr(committed, matrix), rtol=0, atol=1e-9 * size)
