"""The reference pages, written from the code when the site is built, and never committed.

``api`` from the table of public names, ``cli`` from the parsers behind ``--help``, ``recipe`` from the JSON Schema.
Needs robustlab alone, so that the tests can read what is written without building the site.
"""

from __future__ import annotations

import enum
import inspect
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from recipe_keys import keys_of

import robustlab as rl
from robustlab.recipe import json_schema

ROOT = Path(__file__).parents[1]


def pages() -> dict[str, str]:
    """Path below ``reference/`` -> text in reStructuredText."""
    return {**api_pages(), **cli_pages(), "recipe.rst": recipe_page()}


def write(folder: Path) -> None:
    """Write `pages` to ``folder``; unchanged files keep their time stamp, so builds stay short."""
    wanted = {folder / name: text for name, text in pages().items()}
    for path in folder.rglob("*.rst"):
        if path not in wanted:
            path.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# --- text ---------------------------------------------------------------------------------------------------------


def plain(text: str) -> str:
    """Return plain text as reStructuredText, with `backticks` as code."""
    parts = re.split(r"``([^`]+)``|`([^`]+)`", text)
    words = [re.sub(r"([\\*`_|<>])", r"\\\1", part or "") for part in parts[::3]]
    codes = [f"\\ ``{one or other}``\\ " for one, other in zip(parts[1::3], parts[2::3], strict=True)]
    return "".join(word + code for word, code in zip(words, [*codes, ""], strict=True))


def heading(text: str, line: str) -> str:
    """A title with its underline."""
    return f"{text}\n{line * len(text)}\n\n"


def indented(text: str, by: str = "   ") -> str:
    """Each line of ``text`` moved to the right."""
    return "".join(f"{by}{line}\n" if line else "\n" for line in text.splitlines())


def first_sentence(obj: object) -> str:
    """The first paragraph of a docstring, up to its first full stop."""
    paragraph = inspect.cleandoc(getattr(obj, "__doc__", None) or "").split("\n\n")[0].replace("\n", " ")
    return re.split(r"(?<=[.])\s", paragraph)[0]


# --- Python -------------------------------------------------------------------------------------------------------


def groups() -> dict[str, list[str]]:
    """Heading -> the public names below it."""
    return {heading: " ".join(modules.values()).split() for heading, modules in rl._GROUPS.items()}


def results() -> dict[str, type]:
    """The classes of what public functions return, by name, as far as they are no public names themselves."""
    found: dict[str, type] = {}
    for name in rl.__all__:
        obj = getattr(rl, name)
        if inspect.isfunction(obj):
            for kind in _classes(typing.get_type_hints(obj).get("return")):
                if kind.__module__.startswith("robustlab.") and kind.__name__ not in rl.__all__:
                    found[kind.__name__] = kind
    return dict(sorted(found.items()))


def _classes(hint: Any) -> Iterator[type]:
    if inspect.isclass(hint) and not typing.get_args(hint):
        yield hint
    for part in typing.get_args(hint):
        yield from _classes(part)


def api_pages() -> dict[str, str]:
    """One page a public name, one a class that only comes back, and a table of contents."""
    made = {}
    index = heading("Python", "=")
    index += "``import robustlab as rl``; every name is loaded on first use. Results are objects, never tuples.\n\n"
    for group, names in groups().items():
        index += heading(group[0].upper() + group[1:], "-") + _listed(
            (n, f"robustlab.{n}", getattr(rl, n)) for n in names
        )
        made |= {f"api/{name}.rst": _api_page(f"robustlab.{name}", getattr(rl, name)) for name in names}
    index += heading("What comes back", "-")
    index += "Classes of results. They are made by the functions above and have no short name of their own.\n\n"
    index += _listed((n, f"{kind.__module__}.{n}", kind) for n, kind in results().items())
    made |= {f"api/{n}.rst": _api_page(f"{kind.__module__}.{n}", kind) for n, kind in results().items()}
    entries = "".join(f"   {Path(name).stem}\n" for name in made)
    return {"api/index.rst": index + "\n.. toctree::\n   :hidden:\n\n" + entries, **made}


def _listed(rows: Any) -> str:
    return "".join(f":py:obj:`{name} <{path}>`\n   {plain(first_sentence(obj))}\n\n" for name, path, obj in rows)


def _api_page(path: str, obj: object) -> str:
    module, _, name = path.rpartition(".")
    if inspect.isclass(obj):
        kind = "exception" if issubclass(obj, BaseException) else "class"
        options = "   :members:\n" + ("   :undoc-members:\n" if issubclass(obj, enum.Enum) else "")
    else:
        kind, options = "function", ""
    return heading(name, "=") + f".. currentmodule:: {module}\n\n.. auto{kind}:: {name}\n{options}"


# --- commands -----------------------------------------------------------------------------------------------------


def commands() -> dict[tuple[str, ...], Any]:
    """Words of a command -> its parser, all commands that can be run."""
    from robustlab.cli.main import GROUPS, parser

    found: dict[tuple[str, ...], Any] = {}

    def walk(words: tuple[str, ...], command: Any) -> None:
        below = getattr(command, "commands", {})
        if not below:
            found[words] = command
        for name, part in below.items():
            walk((*words, name), part)

    for name in GROUPS:
        walk((name,), parser(name))
    return found


def cli_pages() -> dict[str, str]:
    """A page for each word after ``robustlab``, and one with what all have in common."""
    from robustlab.cli.main import GROUPS, help_text

    top = (
        heading("Commands", "=")
        + "What ``robustlab --help`` prints:\n\n.. code-block:: text\n\n"
        + indented(help_text())
    )
    top += "\n.. toctree::\n\n" + "".join(f"   {name}\n" for name in GROUPS)
    made = {"cli/index.rst": top}
    for name, (_, line) in GROUPS.items():
        below = {words: command for words, command in commands().items() if words[0] == name}
        page = heading(f"robustlab {name}", "=") + plain(line) + "\n\n"
        for words, command in below.items():
            if words != (name,):
                page += heading(" ".join(("robustlab", *words)), "-")
            page += _command(" ".join(("robustlab", *words)), command)
        made[f"cli/{name}.rst"] = page
    return made


def _command(words: str, command: Any) -> str:
    context = command.make_context(words, [], resilient_parsing=True)
    usage = " ".join([words, *command.collect_usage_pieces(context)])
    text = f".. program:: {words}\n\n.. code-block:: text\n\n   {usage}\n\n"
    text += "\n\n".join(_paragraph(part) for part in inspect.cleandoc(command.help or "").split("\n\n")) + "\n\n"
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            text += f".. option:: {record[0]}\n\n" + indented(plain(record[1])) + "\n"
    return text


def _paragraph(text: str) -> str:
    """A paragraph of help; an example is kept as it is typed."""
    label, _, example = text.partition(": robustlab ")
    if label == "Example":
        return "Example:\n\n.. code-block:: sh\n\n" + indented("robustlab " + example)
    return plain(text)


# --- recipes ------------------------------------------------------------------------------------------------------


def recipe_page() -> str:
    """Every key of a recipe, by the JSON Schema."""
    schema = json_schema()
    parts = schema["$defs"]
    steps = {p["properties"]["do"]["const"]: p for p in parts.values() if "const" in p["properties"].get("do", {})}
    text = heading("Recipes", "=") + plain(schema["description"]) + "\n\n"
    text += (
        "A recipe is a TOML file. An editor that knows JSON Schema completes and checks it by what\n"
        "``robustlab recipe schema`` prints; ``robustlab recipe check FILE`` checks a file,\n"
        "``robustlab recipe new NAME`` starts one.\n\n"
    )
    text += heading("The file", "-") + _keys(schema, parts)
    text += (
        heading("[[require]]", "-")
        + plain(parts["Requirement"]["description"])
        + "\n\n"
        + _keys(parts["Requirement"], parts)
    )
    for name in sorted(steps):
        text += f".. _step-{name}:\n\n" + heading(name, "-") + f'.. code-block:: toml\n\n   do = "{name}"\n\n'
        text += (
            "\n\n".join(plain(p) for p in steps[name].get("description", "").split("\n\n"))
            + "\n\n"
            + _keys(steps[name], parts)
        )
    return text


def _keys(part: dict[str, Any], parts: dict[str, Any]) -> str:
    """A list of the keys of a table: what each takes, its default, what it means; tables within it below it."""
    return "".join(
        f"``{key.name}`` : {', '.join([key.takes, *key.needed_or_default()])}\n   {plain(key.meaning) or '..'}\n\n"
        for key in keys_of(part, parts)
    )


if __name__ == "__main__":
    write(Path(__file__).parent / "reference")
