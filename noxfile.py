"""The same checks as `.ci/run`, one session each and over several interpreters: ``nox -l`` lists them."""

from pathlib import Path

import nox

nox.options.sessions = ["lint", "types", "tests"]

# Unit tests that need nothing but what the package itself needs, from models and files to bounds, norms and synthesis.
CORE = [
    f"tests/unit/{name}.py"
    for name in (
        "linear_analysis/test_statespace_model",
        "uncertainty/test_uncertainty_blocks",
        "storage/test_storage_interchange",
        "recipe/test_recipe_load",
        "dynamics/test_dynamics_plants",
        "norms/test_norms_hinf",
        "mu_analysis/test_mu_matrix",
        "synthesis/test_synthesis_hinf",
        "worst_case_analysis/test_worst_case_metrics",
        "report/test_report_html",
    )
]
METRICS = "tests/unit/worst_case_analysis/test_worst_case_metrics.py"


@nox.session
def lint(session: nox.Session) -> None:
    """Style and layers."""
    session.install("-e", ".[dev]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports")


@nox.session
def types(session: nox.Session) -> None:
    """Types."""
    session.install("-e", ".[dev]")
    session.run("pyright")


@nox.session(python=["3.11", "3.12", "3.13"])
def tests(session: nox.Session) -> None:
    """All tests."""
    session.install("-e", ".[dev]")
    session.run("pytest", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """The site, with its tutorials executed, and a look at it and at a report in the browser, if any."""
    session.install("-e", ".[docs]")
    session.run("sphinx-build", "--jobs", "2", "--fail-on-warning", "--keep-going", "docs", "out/docs")
    session.run("python", "docs/check_site.py", "out/docs", success_codes=[0, 5])
    session.run("robustlab", "run", "first-light", "--out", "out/first-light")
    session.run("python", "docs/check_report.py", "out/first-light/report.html", success_codes=[0, 5])


@nox.session(python="3.11")
def oldest(session: nox.Session) -> None:
    """The core's tests with the oldest versions that pyproject.toml allows; `nox -s oldest -- tests` runs more."""
    constraints = f"{session.create_tmp()}/oldest.txt"
    with Path(constraints).open("w", encoding="utf-8") as file:
        session.run("python", ".ci/oldest_versions.py", stdout=file)
    session.install("-c", constraints, "-e", ".", "pytest>=8.3", "hypothesis>=6.112")
    # Old libraries beside new ones deprecate each other; that is not what is tested here. And with some older numpy the
    # last bits of a sample depend on its batch: seen with 2.0, 2.1, 2.2 and 2.4.0, not with 2.3.5 and 2.4.6.
    apart = (
        "-W",
        "ignore::DeprecationWarning",
        "--deselect",
        f"{METRICS}::test_a_sample_has_one_value_whatever_its_batch",
    )
    session.run("pytest", *apart, "-m", "not slow", *(session.posargs or CORE))


@nox.session
def reproducible(session: nox.Session) -> None:
    """Sdist and wheel are the same bytes when they are built twice."""
    session.run(".ci/reproducible", external=True, env={"PYTHON": f"{session.bin}/python"})
