"""The same checks as `.ci/run`, one session each and over several interpreters: ``nox -l`` lists them."""

import nox

nox.options.sessions = ["lint", "types", "tests"]


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
    """The site, with its tutorials executed, and a look at it in the browser, if there is one."""
    session.install("-e", ".[docs]")
    session.run("sphinx-build", "--jobs", "2", "--fail-on-warning", "--keep-going", "docs", "out/docs")
    session.run("python", "docs/check_site.py", "out/docs", success_codes=[0, 5])


@nox.session
def oldest(session: nox.Session) -> None:
    """All tests with the oldest versions that pyproject.toml allows."""
    session.install("uv")
    session.run(
        "uv", "pip", "install", "--python", session.virtualenv.location, "--resolution", "lowest-direct", "-e", ".[dev]"
    )
    session.run("pytest", *session.posargs)
