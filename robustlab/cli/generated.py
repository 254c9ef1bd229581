"""Commands made of doors: options, help and completion from the declaration, the answer from the result's own face."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from inspect import Parameter as Given
from inspect import Signature, signature
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import typer

from robustlab.cli.columns import read_named, signals_of
from robustlab.cli.console import FIGURE, emit, note, require_trust, result_alone, save_drawing, save_figures
from robustlab.cli.offers import one_of, plant_or_file
from robustlab.cli.options import RecordOptions
from robustlab.cli.plant import machine
from robustlab.cli.progress import MODES, ProgressOptions
from robustlab.doors.declaration import COMMANDS, REQUIRED, Door, InLoop, Parameter, load_family
from robustlab.doors.kinds import Choice, Feedback, Flag, Kind, Machine, Pair, RecordFile, Table, TextFile, Thing
from robustlab.errors import EXIT_REQUIREMENT_NOT_MET, EnvironmentFault, RobustlabError, UsageError
from robustlab.shown import text_table

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
VERBOSE = ("verbose", bool, typer.Option("--verbose", help="A line on stderr for each step of the search."), False)
DRAWN = ("figure", str | None, typer.Option(help=FIGURE), None)


def add_commands(app: typer.Typer, group: str, *families: str) -> None:
    """Add to a group's parser the commands that the families of doors declare for it."""
    for family in families:
        load_family(family)
    found: dict[str, dict[str, Door]] = {}
    for words, declared in COMMANDS.items():
        plain, dashes, option = words.partition(" --")
        if plain.split(" ")[0] == group and not declared.own:
            found.setdefault(plain, {})[dashes.strip() + option] = declared
    for plain, doors in found.items():
        main = next(iter(doors.values()))
        app.command(plain.removeprefix(group).strip() or group)(choosing_command(plain, doors, main))


class Beyond(NamedTuple):
    """What a command says and does beyond its result."""

    json: Mapping[str, Any] = {}
    text: str | None = None  # in the place of the result's own
    note: str = ""  # on stderr, after the result
    exit_code: int = 0


# Result, values of the door's parameters, options of the command's own, files read -> what is beyond the result.
More = Callable[[Any, Mapping[str, Any], Mapping[str, Any], list[str]], Beyond]


def command_of(declared: Door, own: Options | None = None, more: More | None = None) -> Callable[..., None]:
    """The command of a door, as the parser takes it."""
    return _parsed(declared.command, {"": declared}, declared, own, more)


def _own(name: str, taken: Any, offered: Any, default: Any) -> Given:
    """An option that is no parameter of the function."""
    return Given(name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[taken, offered])


def choosing_command(words: str, doors: Mapping[str, Door], main: Door) -> Callable[..., None]:
    """One command for several doors: an option says which is meant."""
    return _parsed(words, doors, main)


def _parsed(
    words: str, doors: Mapping[str, Door], main: Door, private: Options | None = None, more: More | None = None
) -> Callable[..., None]:
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
    words_of = [option.partition("=")[2] for option in doors if "=" in option]
    if words_of:  # "--kind=h2": the value of an option chooses, the first where none is given
        chooser = next(iter(doors)).partition("=")[0]
        offered[_field(chooser)] = Parameter(
            _field(chooser), Choice(tuple(words_of)), words_of[0], "Which is asked for."
        )
    by_option = {option: name for name, p in offered.items() for option in p.options}
    choosing = {} if words_of else {option: by_option.get(option, _field(option)) for option in doors if option}
    files = [p for p in offered.values() if isinstance(p.kind, Thing) and p.needed]
    offers = [_given(p, alone=len(files) == 1) for p in offered.values()]
    offers += [
        Given(name, Given.KEYWORD_ONLY, default=False, annotation=Annotated[bool, typer.Option(o, help=doors[o].title)])
        for o, name in choosing.items()
        if o not in by_option
    ]
    things = [(p.kind, p.called.option) for p in offered.values() if isinstance(p.kind, Thing)]
    reading = dict.fromkeys(kind.reading for kind, option in things if kind.reading != "model" or not option)
    if any(kind.settings for kind, _ in things):
        reading["plant"] = None
    written = private if private is not None else (OUT, *([DRAWN] if any(_draws(d) for d in doors.values()) else []))
    told = [VERBOSE] if any(d.takes_progress and not d.progress for d in doors.values()) else []
    own = [*(option for kind in reading for option in READ[kind]), *written, *told, AS_JSON, PROGRESS]
    offers += [_own(*option) for option in own]

    def command(**given: Any) -> None:
        shared = {name: given.pop(name) for name, *_ in own}
        chosen = _chosen(words, doors, offered, choosing, given)
        answer(words, chosen, {p.name: given[p.name] for p in chosen.parameters if p.name in given}, shared, more)

    offers.sort(key=lambda p: p.default is not Given.empty)
    command.__signature__ = Signature(offers)
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
    choosing: Mapping[str, str],
    given: dict[str, Any],
) -> Door:
    """The door that the options choose; what it does not take is refused, and what it needs is asked for."""
    by_word = next(iter(doors)).partition("=")[0] if any("=" in option for option in doors) else ""
    if by_word:
        word = offered[_field(by_word)].kind.read(by_word, given[_field(by_word)])
        choosing = {f"{by_word}={word}": _field(by_word)}
    asked = [option for option, name in choosing.items() if given.get(name) not in (None, False, [])]
    if len(asked) > 1:
        raise UsageError(words, " and ".join(asked), "one of them")
    option = asked[0] if asked else ""
    chosen = doors[option]
    taken = {p.name for p in chosen.parameters}
    for name, p in offered.items():
        default = None if p.default is REQUIRED else p.default
        if name not in taken | {_field(by_word)} and given.get(name) not in (None, default, []):
            others = [o.replace("=", " ") for o, d in doors.items() if o and name in {q.name for q in d.parameters}]
            expected = f"{p.options[0]} with {' or '.join(others)} only" if others else f"it without {option}"
            asked_by = f" with {option}".replace("=", " ") if option else ""
            raise UsageError(words, f"{_called(p)}{asked_by}", expected)
    for p in chosen.parameters:
        if p.needed and p.name in offered and given.get(p.name) in (None, []):
            missing = _called(offered[p.name])
            raise UsageError(words, f"no {missing}", ", or ".join([missing, *choosing]))
    return chosen


def _called(p: Parameter) -> str:
    """The option, or the name of an argument."""
    return p.options[0] if p.called.option or not isinstance(p.kind, Thing) else p.name.upper()


def answer(
    words: str, chosen: Door, given: dict[str, Any], shared: Mapping[str, Any], more: More | None = None
) -> None:
    """Read the files and words, compute, and answer with the result's own face."""
    files: list[str] = []
    out, figure = shared.get("out"), shared.get("figure")
    if out is not None and not Path(out).resolve().parent.is_dir():  # before the work whose result it is for
        raise EnvironmentFault(out, "no such folder", "a folder that exists")
    with ProgressOptions(shared["progress"]).shown(
        words, lines=chosen.progress != "", verbose=shared.get("verbose", False), budgets=chosen.progress != "parts"
    ) as report:
        values = _values(chosen, given, shared, files)
        above = _overruled(values, given)
        if chosen.takes_progress:
            values["progress"] = report.listener if chosen.progress == "parts" else report
        if chosen.takes_drawn:
            values["drawn"] = figure is not None
        try:
            found = {part: chosen(**case) for part, case in _cases(chosen, values, files, out).items()}
        except RobustlabError as error:
            error.hint = error.hint and chosen.hint(error.hint, of_command=True)
            raise
        beyond = Beyond()
        if more is not None:
            beyond = more(found[""].result, values, {**shared, "named": given, "report": report}, files)
        said = _note(chosen, given, shared, files)
        written = [_keep(words, chosen, one.result, values, out, files, given, said) for one in found.values() if out]
        rows = [f"written: {file}" for file in written]
        if figure is not None:
            report("figures")
            written += [file for part, one in found.items() for file in _draw(one, figure, part)]
    for remark in dict.fromkeys(text for one in found.values() for text in one.notes):
        note(remark)
    text = "\n".join(f"{part}: {_text(one)}" if part else _text(one) for part, one in found.items())
    text = above + text.replace("as the controller says", f"as {given.get('controller')} says")
    json = {part: _json(one) for part, one in found.items()}
    shown = {**(json if len(json) > 1 else json[""]), **({"files": written} if written else {}), **beyond.json}
    emit(words, shown, "\n".join([text if beyond.text is None else beyond.text, *rows]), shared["as_json"])
    if beyond.note:
        note(beyond.note)
    if beyond.exit_code:
        raise typer.Exit(beyond.exit_code)
    for one in found.values():
        _require(one)


def _require(one: InLoop) -> None:
    """Leave with the exit code of what cannot be trusted, or was asked for and is not met."""
    if hasattr(one.result, "require"):
        one.result.require()
    for result in (one.result, *one.beside.values()):
        for status in getattr(result, "statuses", [getattr(result, "status", None)]):
            if status is not None:
                require_trust(status)
    if getattr(one.result, "met", None) is False:
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


def _cases(chosen: Door, values: dict[str, Any], files: list[str], out: str | None) -> dict[str, dict[str, Any]]:
    """The calls: one, or that of the nominal and that of the perturbed model of a file with both."""
    kinds = {p.name: p.kind for p in chosen.parameters}
    pairs = [name for name, v in values.items() if isinstance(v, Pair) and not getattr(kinds.get(name), "pair", False)]
    if not pairs:
        return {"": values}
    if len(pairs) > 1 or out is not None:
        hint = "--group nominal, or --group perturbed"
        raise UsageError(files[0], "two models, nominal and perturbed", "one", hint)
    return {part: {**values, pairs[0]: getattr(values[pairs[0]], part)} for part in Pair._fields}


def _text(one: InLoop) -> str:
    """The result's report, the loop before it, behind it what was asked for and what stands beside it."""
    tables = [f"{part.title}\n{text_table(part.rows, part.header)}".lstrip() for part in one.parts if part.rows]
    beside = [
        f"{name}  {found}" if isinstance(found, str) else found.report()
        for name, found in one.beside.items() if isinstance(found, str) or found.facts()
    ]  # fmt: skip
    return "\n\n".join([*([f"loop  {one.loop}"] if one.loop else []), one.result.report(), *tables, *beside])


def _json(one: InLoop) -> Mapping[str, Any]:
    """What a result is as JSON, of one with time series all but these; what stands beside it by name."""
    result = one.result
    without = {"series": False} if "series" in signature(result.to_json).parameters else {}
    beside = {name: found for name, found in one.beside.items() if isinstance(found, str) or hasattr(found, "to_json")}
    return {**result.to_json(**without), **beside, **({"loop": one.loop} if one.loop else {})}


def _values(chosen: Door, given: Mapping[str, Any], shared: Mapping[str, Any], files: list[str]) -> dict[str, Any]:
    """The values of the door's parameters that were given; the files that they are read from are noted down."""
    found: dict[str, Any] = {}
    things = {p.key: p for p in chosen.parameters if isinstance(p.kind, Thing)}
    # Models first: they say what a record's columns are called, and what units a signal's value may have.
    for p in sorted(chosen.parameters, key=lambda p: (p.key not in things, isinstance(p.kind, RecordFile))):
        if p.name not in given:
            continue
        if isinstance(p.kind, (Thing, TextFile)):
            value = _read(p, given[p.name], shared, files, found)
        elif isinstance(p.kind, Table) and p.kind.of in things:
            units = {s.name: s.unit for s in signals_of(found.get(things[p.kind.of].name))}
            value = p.kind.read(p.options[0], given[p.name], units)
        else:
            value = p.kind.read(p.options[0], given[p.name])
        if not _left_out(chosen, p.name, value):
            found[p.name] = value
    return found


def _overruled(found: dict[str, Any], given: Mapping[str, Any]) -> str:
    """The note above the number where ``--feedback`` contradicts the controller, which then says nothing any more."""
    sign, K = found.get("sign"), found.get("controller")
    if sign is None or K is None:
        return ""
    from robustlab.closing import SIGNS, as_controller, silenced
    from robustlab.signals import Taken, law

    inputs = as_controller(K, "controller").inputs
    if all(s.sign in (0, sign) for s in inputs if isinstance(s, Taken)):
        return ""
    found["controller"] = silenced(K, "controller")
    word = "negative" if sign < 0 else "positive"
    return f"note: {given['controller']} says {law(inputs)}; --feedback {word} closes {SIGNS[sign]} all the same\n"


def _read(p: Parameter, given: Any, shared: Mapping[str, Any], files: list[str], found: Mapping[str, Any]) -> Any:
    """What stands in the files that a parameter names."""
    kind: Any = p.kind
    names = [given] if isinstance(given, str) else list(given or [])
    if isinstance(kind, TextFile):
        files += [name for name in names if Path(name).is_file()]
        return given
    options = [*READ[kind.reading], *(READ["plant"] if kind.settings else [])]
    reading = {name: shared[name] for name, *_ in options if name in shared}
    if not names and kind.reading == "plant" and reading.get("settings"):
        option = p.options[0]
        raise UsageError(f"--set {reading['settings'][0]}", f"no {option}", f"{option} PLANT with it")
    if isinstance(kind, RecordFile):
        beside = next((v for v in found.values() if hasattr(v, "outputs")), None)
        records = [read_named(RecordOptions(**reading), beside, name, files, kind.remarks) for name in names]
        return (records or None) if kind.many else records[0] if records else None
    files += [name for name in names if Path(name).is_file()]
    if isinstance(kind, Machine):
        return machine(kind, names[0], **reading) if names else None
    things = [_loaded(kind, name, {key: value for key, value in reading.items() if value}) for name in names]
    return things if kind.many else things[0] if things else None


def _loaded(kind: Thing, name: str, reading: Mapping[str, Any]) -> Any:
    """What one name stands for; code of the user's may print, and the result alone goes to stdout."""
    from robustlab.doors.reading import runs_code

    if "plant" in kind.gives and runs_code(name):
        result_alone()
    return kind.load(name, note, **reading)


def _note(chosen: Door, given: Mapping[str, Any], shared: Mapping[str, Any], files: Sequence[str]) -> str:
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
    words: str,
    chosen: Door,
    result: Any,
    values: Mapping[str, Any],
    out: str,
    files: list[str],
    given: Mapping[str, Any],
    said: str,
) -> str:
    """Write what was made or found; its path."""
    import robustlab as rl

    rl.save(out, chosen.made_of(result), provenance_of(words, files, values, given.get("seed"), said))
    return out


def provenance_of(
    words: str, files: list[str], values: Mapping[str, Any], seed: int | None = None, said: str = ""
) -> Any:
    """Where something comes from: the files read, and the code of plants."""
    from robustlab.provenance import Provenance, code_of, file_sha256

    code = {file: sha for value in values.values() for file, sha in code_of(value).items()}
    return Provenance.now(words, {f: file_sha256(f) for f in files} | code, seed, said)


def _left_out(chosen: Door, name: str, value: Any) -> bool:
    """An option that was not given keeps the function's own default."""
    return value is None and any(p.name == name and not p.needed for p in chosen.parameters)


def _draw(one: InLoop, figure: str, part: str) -> list[str]:
    """Write every picture of the result that can be drawn, and of what stands beside it; the paths."""
    from robustlab.report.drawing_table import PREFIXES, SETS
    from robustlab.report.drawings import pictures_of

    pictures = dict(pictures_of(one.result, note))
    for result in one.beside.values():
        pictures |= dict(pictures_of(result, note))
    kind = type(one.result).__name__
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
    positional = isinstance(p.kind, Thing) and not p.called.option and (p.kind.positional or p.needed)
    kind: Any = p.kind.annotation()
    help_text = p.help if not isinstance(p.kind, Choice) else f"{p.help} One of {', '.join(p.kind.words)}.".strip()
    if positional:
        metavar = "FILE..." if isinstance(p.kind, Thing) and p.kind.many else "FILE" if alone else p.name.upper()
        option: Any = typer.Argument(help=help_text, metavar=metavar, autocompletion=_offer(p.kind))
        default: Any = Given.empty if p.needed else None
        taken = kind if p.needed else kind | None
        return Given(p.name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[taken, option])
    if p.called.option == "*":
        return Given(p.name, Given.KEYWORD_ONLY, default=None, annotation=Annotated[
            kind | None, typer.Argument(help=help_text, metavar=f"[{p.kind.metavar}]...")])  # fmt: skip
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
