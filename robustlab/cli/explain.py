"""``robustlab explain``: the paragraph on a status, a verdict, an exit code, a kind of effects or an effect.

The words are those of ``words.md`` beside this module, which the documentation shows, too; kinds and effects explain
themselves.
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
        typer.Argument(help="A status, a verdict, an exit code (4, or 'exit code 4'), the id of a kind or an effect."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what a status, a verdict, an exit code, a kind of effects or an effect means.

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
    name = asked.replace(" ", "-")
    found = words.get(asked) or _kind(name) or _effect(name)
    if found is None:
        from robustlab.dynamics.effects.catalogue import catalogue
        from robustlab.dynamics.effects.kinds import KINDS

        known = [*words, *KINDS, *catalogue()]
        hint = did_you_mean(asked, known) or "robustlab explain lists the words"
        expected = "a status, a verdict, an exit code, a kind or an effect"
        raise UsageError("robustlab explain", f"{word!r}", expected, hint)
    emit("explain", {"word": asked, "meaning": found}, "\n".join(_lines(found)), as_json)


def _kind(name: str) -> str | None:
    """What the tree of kinds says of one of its nodes."""
    from robustlab.dynamics.effects.kinds import KIND_OF, KINDS, MEANINGS, upwards

    kind = KINDS.get(name)
    if kind is None:
        return None
    members = [effect for effect, own in KIND_OF.items() if name in [k.id for k in upwards(own)]]
    wider = f", a part of: {KINDS[kind.wider].title}" if kind.wider else ""
    said = [f"A kind of effects: {kind.title}{wider}.", f"Its members: {', '.join(members)}."]
    if kind.quantities:
        said.append(f"All can be asked for: {'; '.join(f'{q} ({MEANINGS[q]})' for q in kind.quantities)}.")
    return " ".join([*said, f"What tells them apart: {kind.form}."] if kind.form else said)


def _effect(name: str) -> str | None:
    """What an effect of the catalogue says of itself."""
    from robustlab.dynamics.effects.catalogue import catalogue

    effect: Any = catalogue().get(name)
    if effect is None:
        return None
    about = " ".join(re.sub(r"\.\. math::.*", "", inspect.getdoc(type(effect)) or "", flags=re.DOTALL).split())
    return f"An effect: {effect.title}, at a {effect.site_kind}. {about} Equation: {effect.equation}"


def _lines(text: str) -> list[str]:
    return textwrap.wrap(text, 96, break_on_hyphens=False)
