"""``robustlab explain``: the paragraph on a status, a verdict, an exit code or an effect.

The words are those of ``words.md`` beside this module, which the documentation shows, too; effects explain themselves.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from importlib import resources
from typing import Annotated, Any

import typer

from robustlab.cli.console import emit
from robustlab.cli.options import JsonOption
from robustlab.errors import did_you_mean

app = typer.Typer(help="Explain a word of a result.", add_completion=False)


def explained() -> dict[str, str]:
    """Word -> its paragraph."""
    text = (resources.files("robustlab.cli") / "words.md").read_text(encoding="utf-8")
    parts = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)[1:]
    return {word: " ".join(said.split()) for word, said in zip(parts[::2], parts[1::2], strict=True)}


@app.command()
def explain(
    word: Annotated[
        str | None,
        typer.Argument(help="A status, a verdict, an exit code (4, or 'exit code 4'), or the id of an effect."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what a status, a verdict, an exit code or an effect means.

    Example: robustlab explain inconclusive
    """
    from robustlab.errors import UsageError

    words = explained()
    if word is None:
        lines = tuple(f"  {name}" for name in words)
        hint = "robustlab effects list has the effects"
        raise UsageError("robustlab explain", "WORD is missing", "one of these, or an effect", hint, lines)
    asked = " ".join(word.lower().replace("_", " ").split())
    asked = f"exit code {asked}" if asked.isdigit() else asked
    found = words.get(asked) or _effect(asked.replace(" ", "-"))
    if found is None:
        from robustlab.dynamics.effects.catalogue import catalogue

        known = [*words, *catalogue()]
        hint = did_you_mean(asked, known) or "robustlab explain lists the words"
        raise UsageError("robustlab explain", f"{word!r}", "a status, a verdict, an exit code or an effect", hint)
    emit("explain", {"word": asked, "meaning": found}, "\n".join(_lines(found)), as_json)


def _effect(name: str) -> str | None:
    """What an effect of the catalogue says of itself."""
    from robustlab.dynamics.effects.catalogue import catalogue

    effect: Any = catalogue().get(name)
    if effect is None:
        return None
    about = " ".join(re.sub(r"\.\. math::.*", "", inspect.getdoc(type(effect)) or "", flags=re.DOTALL).split())
    return f"An effect: {effect.title}, at a {effect.site_kind}. {about} Equation: {effect.equation}"


def _lines(text: str) -> list[str]:
    return textwrap.wrap(text, 96)
