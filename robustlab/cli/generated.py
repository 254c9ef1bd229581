"""Commands made of doors: options, help and completion from the declaration, the answer from the result's own face."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from inspect import Parameter as Given
from inspect import Signature
from typing import Annotated, Any

import typer

from robustlab.cli.console import FIGURE, emit, note, require_trust, result_alone, save_drawing
from robustlab.cli.offers import one_of, plant_or_file
from robustlab.cli.progress import MODES, ProgressOptions
from robustlab.doors.declaration import COMMANDS, REQUIRED, Door, Parameter, load_family
from robustlab.doors.kinds import Choice, Feedback, Flag, Kind, Pair, TextFile, Thing
from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, UsageError

# What every command has beside its own.
OUT = ("out", str | None, typer.Option("--out", "-o", help="File to write."), None)
AS_JSON = ("as_json", bool, typer.Option("--json", help="Print one JSON object instead of text."), False)
PROGRESS = (
    "progress", str,
    typer.Option(help="auto: a bar on terminals; json: JSON lines on stderr; none.", autocompletion=one_of(*MODES)),
    "auto",
)  # fmt: skip
# How files of models are read.
READ = (
    ("group", str | None, typer.Option("--group", help="Group of the file that holds the model."), None),
    ("transpose", bool, typer.Option("--transpose", help="The file was written column by column: swap A, B, C, D."),
     False),
    ("no_verify", bool, typer.Option("--no-verify", help="Load although the content hash does not match."), False),
)  # fmt: skip
SETTINGS = (
    "settings", list[str] | None,
    typer.Option("--set", help="Value or choice of a plant, NAME=VALUE, such as motors=true; repeatable."), None,
)  # fmt: skip
_READING = (*(name for name, *_ in READ), "settings")
DRAWN = ("figure", str | None, typer.Option(help=FIGURE), None)


def add_commands(app: typer.Typer, group: str, *families: str) -> None:
    """Add to a group's parser the commands that the families of doors declare for it."""
    for family in families:
        load_family(family)
    found: dict[str, dict[str, Door]] = {}
    for words, declared in COMMANDS.items():
        plain, dashes, option = words.partition(" --")
        if plain.split(" ")[0] == group:
            found.setdefault(plain, {})[dashes.strip() + option] = declared
    for plain, doors in found.items():
        main = next(iter(doors.values()))
        app.command(plain.removeprefix(group).strip() or group)(choosing_command(plain, doors, main))


def command_of(declared: Door) -> Callable[..., None]:
    """The command of a door, as the parser takes it."""
    return _parsed(declared.command, {"": declared}, declared)


def choosing_command(words: str, doors: Mapping[str, Door], main: Door) -> Callable[..., None]:
    """One command for several doors: an option says which is meant.

    ``doors``: option of a parameter or flag that chooses -> the door; ``""`` is the door where none is given. Whatever
    option belongs to none of the chosen door's parameters is refused.
    """
    return _parsed(words, doors, main)


def _parsed(words: str, doors: Mapping[str, Door], main: Door) -> Callable[..., None]:
    offered: dict[str, Parameter] = {}
    for declared in doors.values():
        for p in declared.parameters:
            if p.called.only != "step":
                known = offered.setdefault(p.name, p)
                if known.default != p.default:  # left out, each function has its own
                    offered[p.name] = replace(known, default=None)
    for name, p in offered.items():
        if p.needed and not all(any(q.name == name for q in d.parameters) for d in doors.values()):
            kind = p.kind if not isinstance(p.kind, Thing) or p.called.option else replace(p.kind, positional=True)
            offered[name] = replace(p, default=None, kind=kind)
    by_option = {option: name for name, p in offered.items() for option in p.options}
    choosing = {option: by_option.get(option, _field(option)) for option in doors if option}
    files = [p for p in offered.values() if isinstance(p.kind, Thing) and p.needed]
    signature = [_given(p, alone=len(files) == 1) for p in offered.values()]
    signature += [
        Given(name, Given.KEYWORD_ONLY, default=False, annotation=Annotated[bool, typer.Option(o, help=doors[o].title)])
        for o, name in choosing.items()
        if o not in by_option
    ]
    reading = [READ] if any(isinstance(p.kind, Thing) and not p.called.option for p in offered.values()) else []
    own = [
        *(option for group in reading for option in group),
        *([SETTINGS] if any(isinstance(p.kind, Thing) and p.kind.settings for p in offered.values()) else []),
        OUT,
        AS_JSON,
        PROGRESS,
        *([DRAWN] if any(_draws(d) for d in doors.values()) else []),
    ]
    signature += [
        Given(name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option])
        for name, kind, option, default in own
    ]

    def command(**given: Any) -> None:
        shared = {name: given.pop(name) for name, *_ in own}
        chosen = _chosen(words, doors, offered, choosing, given)
        answer(words, chosen, {p.name: given[p.name] for p in chosen.parameters if p.name in given}, shared)

    signature.sort(key=lambda p: p.default is not Given.empty)
    command.__signature__ = Signature(signature)  # pyright: ignore[reportAttributeAccessIssue]
    command.__annotations__ = {p.name: p.annotation for p in signature}
    command.__name__ = words.replace(" ", "_").replace("-", "_")
    command.__doc__ = "\n\n".join(
        filter(None, (main.title, main.more, f"Example: {main.example}" if main.example else ""))
    )
    return command


def _chosen(
    words: str,
    doors: Mapping[str, Door],
    offered: Mapping[str, Parameter],
    choosing: Mapping[str, str],
    given: dict[str, Any],
) -> Door:
    """The door that the options choose; what it does not take is refused, and what it needs is asked for."""
    asked = [option for option, name in choosing.items() if given.get(name) not in (None, False, [])]
    if len(asked) > 1:
        raise UsageError(words, " and ".join(asked), "one of them")
    option = asked[0] if asked else ""
    chosen = doors[option]
    taken = {p.name for p in chosen.parameters}
    for name, p in offered.items():
        default = None if p.default is REQUIRED else p.default
        if name not in taken and given.get(name) not in (None, default, []):
            others = [o for o, d in doors.items() if o and name in {q.name for q in d.parameters}]
            expected = f"{p.options[0]} with {' or '.join(others)} only" if others else f"it without {option}"
            raise UsageError(words, f"{_called(p)}{f' with {option}' if option else ''}", expected)
    for p in chosen.parameters:
        if p.needed and p.name in offered and given.get(p.name) in (None, []):
            missing = _called(offered[p.name])
            raise UsageError(words, f"no {missing}", ", or ".join([missing, *choosing]))
    return chosen


def _called(p: Parameter) -> str:
    """The option, or the name of an argument."""
    return p.options[0] if p.called.option or not isinstance(p.kind, Thing) else p.name.upper()


def answer(words: str, chosen: Door, given: dict[str, Any], shared: Mapping[str, Any]) -> None:
    """Read the files and words, compute, and answer with the result's own face."""
    files: dict[str, str] = {}
    reading = {name: shared[name] for name in _READING if shared.get(name)}
    values = {p.name: _read(p, given[p.name], reading, files) for p in chosen.parameters if p.name in given}
    values = {name: v for name, v in values.items() if not _left_out(chosen, name, v)}
    kinds = {p.name: p.kind for p in chosen.parameters}
    pairs = [name for name, v in values.items() if isinstance(v, Pair) and not getattr(kinds[name], "pair", False)]
    if pairs and (len(pairs) > 1 or shared["out"] is not None):
        hint = "--group nominal, or --group perturbed"
        raise UsageError(next(iter(files)), "two models, nominal and perturbed", "one", hint)
    with ProgressOptions(shared["progress"]).shown(words) as report:
        if chosen.takes_progress:
            values["progress"] = report
        cases = {"": values} if not pairs else {
            part: {**values, pairs[0]: getattr(values[pairs[0]], part)} for part in Pair._fields
        }  # fmt: skip
        found = {part: chosen(**case) for part, case in cases.items()}
        results = {part: answered.result for part, answered in found.items()}
        said = _note(chosen, given, shared, files)
        rows = [_keep(words, chosen, result, shared["out"], files, given, said) for result in results.values()]
        if shared.get("figure") is not None:
            report("figures")
            for part, result in results.items():
                _draw(result, shared["figure"], part)
    for remark in dict.fromkeys(text for answered in found.values() for text in answered.notes):
        note(remark)
    text = "\n".join(
        ("loop  " + loop + "\n\n" if loop else "") + (f"{part}: " if part else "") + result.report()
        for part, (result, loop, _) in found.items()
    )
    json = {part: {**result.to_json(), **({"loop": loop} if loop else {})} for part, (result, loop, _) in found.items()}
    shown = json if pairs else json[""]
    emit(words, shown, "\n".join([text, *filter(None, rows)]), shared["as_json"])
    for result in results.values():
        for status in getattr(result, "statuses", [result.status] if hasattr(result, "status") else []):
            require_trust(status)
        if getattr(result, "shown", None) is False:  # what was to be shown is not
            raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


def _read(p: Parameter, given: Any, reading: Mapping[str, Any], files: dict[str, str]) -> Any:
    """The value of a parameter; the files that it is read from are noted down with their SHA-256."""
    if not isinstance(p.kind, (Thing, TextFile)):
        return p.kind.read(p.options[0], given)
    from robustlab.doors.reading import made_of, runs_code

    names = [given] if isinstance(given, str) else list(given or [])
    if isinstance(p.kind, TextFile):
        files.update({file: sha for name in names for file, sha in made_of(name, None).items()})
        return given
    found = []
    for name in names:
        if "plant" in p.kind.gives and runs_code(name):
            result_alone()
        found.append(p.kind.load(name, note, **reading if p.kind.settings else _without(reading, "settings")))
        files.update(made_of(name, found[-1]))
    return found if p.kind.many else found[0] if found else None


def _without(given: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in given.items() if key != name}


def _note(chosen: Door, given: Mapping[str, Any], shared: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """What was asked for beside the files: names of plants, and the options that are not as by default, as typed."""
    words = []
    for p in chosen.parameters:
        value = given.get(p.name)
        if value not in (None, _as_text(p), []):
            word = "" if isinstance(p.kind, Thing) and not p.called.option else p.options[-1].lstrip("-")
            texts = value if isinstance(value, list) else [value]
            words += [f"{word} {text}".strip() for text in texts if word or text not in files]
    return ", ".join([*words, *(f"set {text}" for text in shared.get("settings") or ())])


def _keep(
    words: str, chosen: Door, result: Any, out: str | None, files: dict[str, str], given: Mapping[str, Any], said: str
) -> str:
    """Write what was made or found, where a file is named for it; the line that says so."""
    if out is None:
        return ""
    import robustlab as rl
    from robustlab.provenance import Provenance

    rl.save(out, chosen.made_of(result), Provenance.now(words, files, given.get("seed"), said))
    return f"written: {out}"


def _left_out(chosen: Door, name: str, value: Any) -> bool:
    """An option that was not given keeps the function's own default."""
    return value is None and any(p.name == name and not p.needed for p in chosen.parameters)


def _draw(result: Any, figure: str, part: str) -> None:
    """Write every picture of the result that can be drawn."""
    from robustlab.report.drawings import pictures_of

    made = 0
    for name, picture in pictures_of(result, note):
        save_drawing(picture.figure, figure, "".join(f"-{text}" for text in (part, name if made else "") if text))
        made += 1
    if not made:
        note("nothing to draw")


def _draws(declared: Door) -> bool:
    """Whether the results have pictures; asked by name, the classes need not be loaded."""
    from robustlab.report.drawing_table import DRAWINGS

    return declared.result.rpartition(".")[2] in DRAWINGS


# --- options ----------------------------------------------------------------------------------------------------------


def _field(option: str) -> str:
    return option.lstrip("-").replace("-", "_")


def _given(p: Parameter, alone: bool) -> Given:
    positional = isinstance(p.kind, Thing) and not p.called.option and (p.kind.positional or p.needed)
    kind: Any = p.kind.annotation()
    help_text = p.help if not isinstance(p.kind, Choice) else f"{p.help} One of {', '.join(p.kind.words)}.".strip()
    if positional:
        metavar = "FILE..." if isinstance(p.kind, Thing) and p.kind.many else "FILE" if alone else p.name.upper()
        option: Any = typer.Argument(help=help_text, metavar=metavar, autocompletion=plant_or_file)
        default: Any = Given.empty if p.needed else None
        taken = kind if p.needed else kind | None
        return Given(p.name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[taken, option])
    option = typer.Option(*p.options, help=help_text, metavar=p.kind.metavar, autocompletion=_offer(p.kind))
    if p.needed:
        return Given(p.name, Given.KEYWORD_ONLY, annotation=Annotated[kind, option])
    if isinstance(p.kind, Flag):
        option = typer.Option(*_flag(p), help=help_text)
    default = _as_text(p)
    if default is None:
        kind = kind | None
    return Given(p.name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option])


def _flag(p: Parameter) -> tuple[str, ...]:
    """``--certify`` of what is off by default, ``--direct/--no-direct`` of what is on."""
    first = p.options[0]
    return (f"{first}/--no-{first.removeprefix('--')}",) if p.default else p.options


def _as_text(p: Parameter) -> Any:
    """The default as the parser would read it."""
    if p.default is None or p.default is REQUIRED:
        return None
    annotation = p.kind.annotation()
    if annotation is str and not isinstance(p.default, str):
        if isinstance(p.default, (list, tuple)):
            return ",".join(f"{value:g}" if isinstance(value, float) else str(value) for value in p.default)
        return f"{p.default:g}" if isinstance(p.default, float) else str(p.default)
    return p.default


def _offer(kind: Kind) -> Any:
    if isinstance(kind, Choice):
        return one_of(*kind.words)
    if isinstance(kind, Thing) and "plant" in kind.gives:
        return plant_or_file
    return one_of("negative", "positive") if isinstance(kind, Feedback) else None
