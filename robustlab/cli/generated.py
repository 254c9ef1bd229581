"""Commands made of doors: options, help and completion from the declaration, the answer from the result's own face."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from inspect import Parameter as Given
from inspect import Signature, signature
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import typer

from robustlab.cli.columns import read_named, signals_of
from robustlab.cli.console import FIGURE, emit, note, require_trust, save_drawing, save_figures
from robustlab.cli.offers import one_of, plant_or_file
from robustlab.cli.options import RecordOptions
from robustlab.cli.plant import machine
from robustlab.cli.progress import MODES, ProgressOptions
from robustlab.doors.declaration import COMMANDS, REQUIRED, Door, Parameter, load_family
from robustlab.doors.kinds import Choice, Feedback, Flag, Kind, Machine, Pair, RecordFile, Table, Thing
from robustlab.errors import UsageError

# What every command has beside its own.
OUT = ("out", str | None, typer.Option("--out", "-o", help="File to write."), None)
AS_JSON = ("as_json", bool, typer.Option("--json", help="Print one JSON object instead of text."), False)
PROGRESS = (
    "progress", str,
    typer.Option(help="auto: a bar on terminals; json: JSON lines on stderr; none.", autocompletion=one_of(*MODES)),
    "auto",
)  # fmt: skip
Options = tuple[tuple[str, Any, Any, Any], ...]  # name, type, option, default


def options_of(group: type) -> Options:
    """The options of a group, as `robustlab.cli.options` writes them."""
    hints = get_type_hints(group, include_extras=True)
    return tuple((f.name, *get_args(hints[f.name]), f.default) for f in fields(group))


# How files are read, by `robustlab.doors.kinds.Thing.reading`.
READ: Mapping[str, Options] = {
    "model": (
        ("group", str | None, typer.Option("--group", help="Group of the file that holds the model."), None),
        ("transpose", bool, typer.Option("--transpose", help="The file was written column by column: swap A, B, C, D."),
         False),
        ("no_verify", bool, typer.Option("--no-verify", help="Load although the content hash does not match."), False),
    ),
    "plant": (("settings", list[str] | None, typer.Option("--set", help="Parameter of the plant: NAME=VALUE."), None),),
    "record": options_of(RecordOptions),
}  # fmt: skip
DRAWN = ("figure", str | None, typer.Option(help=FIGURE), None)


def add_commands(app: typer.Typer, group: str, *families: str) -> None:
    """Add to a group's parser the commands that the families of doors declare for it."""
    for family in families:
        load_family(family)
    for words, declared in COMMANDS.items():
        first, _, name = words.partition(" ")
        if first == group and name and not declared.own:
            app.command(name)(command_of(declared))


class Beyond(NamedTuple):
    """What a command says and does beyond its result."""

    json: Mapping[str, Any] = {}
    text: str | None = None  # in the place of the result's own
    note: str = ""  # on stderr, after the result
    exit_code: int = 0


# Result, values of the door's parameters, options of the command's own, files read -> what is beyond the result.
More = Callable[[Any, Mapping[str, Any], Mapping[str, Any], list[str]], Beyond]


def command_of(declared: Door, own: Options | None = None, more: More | None = None) -> Callable[..., None]:
    """The command of a door, as the parser takes it.

    ``own``: options beside those of the door and its files, in the place of ``--out`` and ``--figure``; ``more`` is
    called while progress is shown, and gets them.
    """
    return _parsed(declared.command, {"": declared}, declared, own, more)


def choosing_command(words: str, doors: Mapping[str, Door], main: Door) -> Callable[..., None]:
    """One command for several doors: an option says which is meant.

    ``doors``: option of a parameter or flag that chooses -> the door; ``""`` is the door where none is given. Whatever
    option belongs to none of the chosen door's parameters is refused.
    """
    return _parsed(words, doors, main)


def _parsed(
    words: str, doors: Mapping[str, Door], main: Door, private: Options | None = None, more: More | None = None
) -> Callable[..., None]:
    offered: dict[str, Parameter] = {}
    for declared in doors.values():
        for p in declared.parameters:
            if p.called.only != "step":
                offered.setdefault(p.name, p)
    flags = {o: _field(o) for o in doors if o and _field(o) not in offered}
    files = [p for p in offered.values() if isinstance(p.kind, Thing) and p.needed]
    offers = [_given(p, alone=len(files) == 1) for p in offered.values()]
    offers += [
        Given(name, Given.KEYWORD_ONLY, default=False, annotation=Annotated[bool, typer.Option(o, help=doors[o].title)])
        for o, name in flags.items()
    ]
    reading = dict.fromkeys(p.kind.reading for p in offered.values() if isinstance(p.kind, Thing))
    written = private if private is not None else (OUT, *([DRAWN] if any(_draws(d) for d in doors.values()) else []))
    own = [*(option for kind in reading for option in READ[kind]), *written, AS_JSON, PROGRESS]
    offers += [
        Given(name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option])
        for name, kind, option, default in own
    ]

    def command(**given: Any) -> None:
        shared = {name: given.pop(name) for name, *_ in own}
        chosen = _chosen(words, doors, offered, flags, given)
        answer(words, chosen, {p.name: given[p.name] for p in chosen.parameters if p.name in given}, shared, more)

    offers.sort(key=lambda p: p.default is not Given.empty)
    command.__signature__ = Signature(offers)  # pyright: ignore[reportAttributeAccessIssue]
    command.__annotations__ = {p.name: p.annotation for p in offers}
    command.__name__ = words.replace(" ", "_").replace("-", "_")
    command.__doc__ = "\n\n".join(
        filter(None, (main.title, main.more, f"Example: {main.example}" if main.example else ""))
    )
    return command


def _chosen(
    words: str,
    doors: Mapping[str, Door],
    offered: Mapping[str, Parameter],
    flags: Mapping[str, str],
    given: dict[str, Any],
) -> Door:
    """The door that the options choose; what it does not take is refused."""
    asked = [
        option for option in doors
        if option and (given.get(flags[option]) if option in flags else given.get(_field(option)) is not None)
    ]  # fmt: skip
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
            raise UsageError(words, f"{p.options[0]}{f' with {option}' if option else ''}", expected)
    return chosen


def answer(
    words: str, chosen: Door, given: dict[str, Any], shared: Mapping[str, Any], more: More | None = None
) -> None:
    """Read the files and words, compute, and answer with the result's own face."""
    files: list[str] = []
    out, figure = shared.get("out"), shared.get("figure")
    with ProgressOptions(shared["progress"]).shown(
        words, lines=chosen.progress != "", budgets=chosen.progress != "parts"
    ) as report:
        values = _values(chosen, given, shared, files)
        pairs = [name for name, v in values.items() if isinstance(v, Pair)]
        if pairs and (len(pairs) > 1 or out is not None):
            raise UsageError(
                files[0], "two models, nominal and perturbed", "one", "--group nominal, or --group perturbed"
            )
        if chosen.takes_progress:
            values["progress"] = report.listener if chosen.progress == "parts" else report
        cases = {"": values} if not pairs else {
            part: {**values, pairs[0]: getattr(values[pairs[0]], part)} for part in Pair._fields
        }  # fmt: skip
        found = {part: chosen(**case) for part, case in cases.items()}
        results = {part: answered.result for part, answered in found.items()}
        beyond = Beyond()
        if more is not None:
            beyond = more(results[""], values, {**shared, "named": given, "report": report}, files)
        written = [_keep(words, chosen, result, values, out, files, given) for result in results.values() if out]
        rows = [f"written: {file}" for file in written]
        if figure is not None:
            report("figures")
            written += [file for part, result in results.items() for file in _draw(result, figure, part)]
    text = "\n".join(
        ("loop  " + loop + "\n\n" if loop else "") + (f"{part}: " if part else "") + result.report()
        for part, (result, loop) in found.items()
    )
    json = {part: {**_json(result), **({"loop": loop} if loop else {})} for part, (result, loop) in found.items()}
    shown = {**(json if pairs else json[""]), **({"files": written} if written else {}), **beyond.json}
    emit(words, shown, "\n".join([text if beyond.text is None else beyond.text, *rows]), shared["as_json"])
    if beyond.note:
        note(beyond.note)
    if beyond.exit_code:
        raise typer.Exit(beyond.exit_code)
    for result in results.values():
        if hasattr(result, "require"):
            result.require()
        if hasattr(result, "status"):
            require_trust(result.status)


def _json(result: Any) -> Mapping[str, Any]:
    """What a result is as JSON; of one with time series all but these."""
    without = {"series": False} if "series" in signature(result.to_json).parameters else {}
    return result.to_json(**without)


def _values(chosen: Door, given: Mapping[str, Any], shared: Mapping[str, Any], files: list[str]) -> dict[str, Any]:
    """The values of the door's parameters that were given; the files that they are read from are noted down."""
    found: dict[str, Any] = {}
    things = {p.key: p for p in chosen.parameters if isinstance(p.kind, Thing)}
    # Models first: they say what a record's columns are called, and what units a signal's value may have.
    for p in sorted(chosen.parameters, key=lambda p: (p.key not in things, isinstance(p.kind, RecordFile))):
        if p.name not in given:
            continue
        if isinstance(p.kind, Thing):
            value = _read(p.kind, p.options[0], given[p.name], shared, files, found)
        elif isinstance(p.kind, Table) and p.kind.of in things:
            units = {s.name: s.unit for s in signals_of(found.get(things[p.kind.of].name))}
            value = p.kind.read(p.options[0], given[p.name], units)
        else:
            value = p.kind.read(p.options[0], given[p.name])
        if not _left_out(chosen, p.name, value):
            found[p.name] = value
    return found


def _read(
    kind: Thing, option: str, given: Any, shared: Mapping[str, Any], files: list[str], found: Mapping[str, Any]
) -> Any:
    """What stands in the files that a parameter names."""
    reading = {name: shared[name] for name, *_ in READ[kind.reading]}
    names = [given] if isinstance(given, str) else list(given or [])
    if not names and reading.get("settings"):
        raise UsageError(f"--set {reading['settings'][0]}", f"no {option}", f"{option} PLANT with it")
    if isinstance(kind, RecordFile):
        beside = next((v for v in found.values() if hasattr(v, "outputs")), None)
        records = [read_named(RecordOptions(**reading), beside, name, files, kind.remarks) for name in names]
        return (records or None) if kind.many else records[0] if records else None
    files += [name for name in names if Path(name).is_file()]
    if isinstance(kind, Machine):
        return machine(kind, names[0], **reading) if names else None
    things = [kind.load(name, note, **reading) for name in names]
    return things if kind.many else things[0] if things else None


def _keep(
    words: str,
    chosen: Door,
    result: Any,
    values: Mapping[str, Any],
    out: str,
    files: list[str],
    given: Mapping[str, Any],
) -> str:
    """Write what was made or found; its path."""
    import robustlab as rl

    rl.save(out, chosen.made_of(result), provenance_of(words, files, values, given.get("seed")))
    return out


def provenance_of(words: str, files: list[str], values: Mapping[str, Any], seed: int | None = None) -> Any:
    """Where something comes from: the files read, and the code of plants."""
    from robustlab.provenance import Provenance, code_of, file_sha256

    code = {file: sha for value in values.values() for file, sha in code_of(value).items()}
    return Provenance.now(words, {f: file_sha256(f) for f in files} | code, seed)


def _left_out(chosen: Door, name: str, value: Any) -> bool:
    """An option that was not given keeps the function's own default."""
    return value is None and any(p.name == name and not p.needed for p in chosen.parameters)


def _draw(result: Any, figure: str, part: str) -> list[str]:
    """Write every picture of the result that can be drawn; the paths."""
    from robustlab.report.drawing_table import PREFIXES, SETS
    from robustlab.report.drawings import pictures_of

    pictures = dict(pictures_of(result, note))
    kind = type(result).__name__
    if kind in SETS:
        figures = {name: picture.figure for name, picture in pictures.items()}
        files = save_figures(figures, figure, PREFIXES.get(kind, ""))
        note("\n".join(f"written: {file}" for file in files))
        return files
    made: list[str] = []
    for name, picture in pictures.items():
        made += save_drawing(picture.figure, figure, "".join(f"-{t}" for t in (part, name if made else "") if t))
    if not made:
        note("nothing to draw")
    return made


def _draws(declared: Door) -> bool:
    """Whether the results have pictures; asked by name, the classes need not be loaded."""
    from robustlab.report.drawing_table import DRAWINGS, SETS

    return declared.result.rpartition(".")[2] in {*DRAWINGS, *SETS}


# --- options ----------------------------------------------------------------------------------------------------------


def _field(option: str) -> str:
    return option.lstrip("-").replace("-", "_")


def _given(p: Parameter, alone: bool) -> Given:
    positional = isinstance(p.kind, Thing) and p.needed
    kind: Any = p.kind.annotation()
    help_text = p.help if not isinstance(p.kind, Choice) else f"{p.help} One of {', '.join(p.kind.words)}.".strip()
    if positional:
        metavar = "FILE..." if isinstance(p.kind, Thing) and p.kind.many else "FILE" if alone else p.name.upper()
        option: Any = typer.Argument(help=help_text, metavar=metavar, autocompletion=plant_or_file)
        return Given(p.name, Given.KEYWORD_ONLY, annotation=Annotated[kind, option])
    option = typer.Option(*p.options, help=help_text, metavar=p.kind.metavar, autocompletion=_offer(p.kind))
    if p.needed:
        return Given(p.name, Given.KEYWORD_ONLY, annotation=Annotated[kind, option])
    if isinstance(p.kind, Flag):
        option = typer.Option(*_flag(p), help=help_text)
    default = _as_text(p)
    if default is None or isinstance(p.kind, Table):
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
    if isinstance(kind, Machine):
        return plant_or_file
    return one_of("negative", "positive") if isinstance(kind, Feedback) else None
