"""Commands generated from operations: options, help and completion from the declaration, output from the result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter as Given
from inspect import Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

import robustlab as rl
from robustlab.cli.completion import one_of, plant_or_file, recipe_or_file
from robustlab.cli.console import FIGURE, emit, note, result_alone, save_figures, shown
from robustlab.display import text_table
from robustlab.errors import (
    EXIT_INTERRUPTED,
    EXIT_REQUIREMENT_NOT_MET,
    EnvironmentFault,
    InputError,
    NoTrustworthyNumber,
    RobustlabError,
    UsageError,
)
from robustlab.operations.declaration import COMMANDS, REQUIRED, InLoop, Operation, Parameter, load_family
from robustlab.operations.parameter_types import (
    Choice,
    Feedback,
    Flag,
    Kind,
    RecordFile,
    Table,
    TextFile,
    Thing,
    comma_separated,
    runs_code,
)
from robustlab.report.drawings import DRAWINGS
from robustlab.units import same_unit

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
ProgressOption = Annotated[
    str,
    typer.Option(
        "--progress", metavar="WORD", help="auto: a bar on terminals; none.", autocompletion=one_of("auto", "none"),
    ),
]  # fmt: skip
RECIPE_FILE = typer.Argument(
    help="A recipe file, or the name of one that comes with robustlab.", autocompletion=recipe_or_file
)
RecipeArgument = Annotated[str, RECIPE_FILE]
ChangesOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a value: a top-level key or STEP.KEY; repeatable."),
]

# Options that all commands share.
OUT = ("out", str | None, typer.Option("--out", "-o", metavar="PATH", help="File to write."), None)
AS_JSON = ("as_json", *get_args(JsonOption), False)
PROGRESS = ("progress", *get_args(ProgressOption), "auto")
Options = tuple[tuple[str, Any, Any, Any], ...]  # name, type, option, default

# Options for reading files, by `robustlab.operations.parameter_types.Thing.reading`.
READ: Mapping[str, Options] = {
    "model": (
        ("group", str | None, typer.Option("--group", metavar="NAME", help="Group of the file that holds the model."),
         None),
        ("transpose", bool, typer.Option("--transpose", help="The file was written column by column: swap A, B, C, D."),
         False),
        ("no_verify", bool, typer.Option("--no-verify", help="Load although the content hash does not match."), False),
    ),
    "plant": (
        ("settings", list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Parameter of the plant."),
         None),
    ),
    "record": (
        ("unit", list[str] | None, typer.Option(metavar="NAME=UNIT", help="Unit that a signal or column is in, phi=deg:"
         " converted to SI."), None),
        ("delimiter", str | None, typer.Option(metavar="SIGN", help="Of a text file: , ; \\t or a blank."), None),
        ("decimal", str, typer.Option(metavar="SIGN", help="Decimal sign of a text file."), "."),
        ("group", str | None, typer.Option(metavar="NAME", help="HDF5 group or MATLAB struct."), None),
        ("inputs", str | None, typer.Option(metavar="NAME,...", help="Inputs: u or u,w; with a model its own if left"
         " out. u=voltage takes the column voltage as u."), None),
        ("outputs", str | None, typer.Option(metavar="NAME,...", help="Outputs likewise, q,i=current; all others if"
         " left out."), None),
        ("dt", float | None, typer.Option(help="Sample time in s."), None),
        ("clock", str | None, typer.Option(metavar="NAME", help="Signal that contains the times."), None),
        ("allow_gaps", bool, typer.Option("--allow-gaps", help="Accept a time base with missing samples."), False),
    ),
}  # fmt: skip
VERBOSE = ("verbose", bool, typer.Option("--verbose", help="A line on stderr for each step of the search."), False)
DRAWN = ("figure", str | None, typer.Option(metavar="PATH", help=FIGURE), None)


# Result, values of the operation's parameters, options of the command, files read -> further JSON, and the text.
More = Callable[[Any, Mapping[str, Any], Mapping[str, Any], list[str]], tuple[Mapping[str, Any], str]]


def add_commands(app: typer.Typer, group: str, *families: str, extended: Mapping[str, Any] | None = None) -> None:
    """Add to a group's parser the commands that the modules of operations declare for it, some of them extended."""
    for family in families:
        load_family(family)
    for words, declared in COMMANDS.items():
        if words.split(" ")[0] == group:
            command = command_of(declared, *(extended or {}).get(words, ()))
            app.command(words.removeprefix(group).strip() or group)(command)


def command_of(declared: Operation, private: Options | None = None, more: More | None = None) -> Callable[..., None]:
    words = declared.command
    offered = [p for p in declared.parameters if p.kind.only != "step"]
    things = [(p.kind, p.kind.option) for p in offered if isinstance(p.kind, Thing)]
    alone = sum(isinstance(p.kind, (Thing, TextFile)) and p.needed and not p.kind.option for p in offered) == 1
    reading = dict.fromkeys(kind.reading for kind, option in things if kind.reading != "model" or not option)
    if any(kind.settings for kind, _ in things):
        reading["plant"] = None
    drawn = declared.result.rpartition(".")[2] in DRAWINGS  # by the class' name, without loading it
    written = private if private is not None else (OUT, *([DRAWN] if drawn else []))
    verbose = [VERBOSE] if declared.takes("progress") and not declared.progress else []
    own = [*(option for kind in reading for option in READ[kind]), *written, *verbose, AS_JSON, PROGRESS]

    def command(**given: Any) -> None:
        shared = {name: given.pop(name) for name, *_ in own}
        answer(words, declared, given, shared, more)

    command.__name__ = words.replace(" ", "_").replace("-", "_")
    command.__doc__ = "\n\n".join(declared.paragraphs)
    return _offering(command, [_given(p, alone) for p in offered], own)


def taking(*own: tuple[str, Any, Any, Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add options to a hand-written command as keyword arguments (decorator)."""

    def offered(command: Callable[..., None]) -> Callable[..., None]:
        known = signature(command, eval_str=True).parameters.values()
        taken = {name for name, *_ in own}
        named = [
            p.replace(kind=Given.KEYWORD_ONLY) for p in known if p.kind is not Given.VAR_KEYWORD and p.name not in taken
        ]
        return _offering(command, named, own)

    return offered


def _offering(command: Any, offers: Sequence[Given], own: Options | Sequence[Any]) -> Callable[..., None]:
    options = [Given(n, Given.KEYWORD_ONLY, default=d, annotation=Annotated[taken, o]) for n, taken, o, d in own]
    every = sorted([*offers, *options], key=lambda p: p.default is not Given.empty)
    command.__signature__ = Signature(every)
    command.__annotations__ = {p.name: p.annotation for p in every}
    return command


def answer(
    words: str, chosen: Operation, given: dict[str, Any], shared: Mapping[str, Any], more: More | None = None
) -> None:
    files: list[str] = []
    out, figure = shared.get("out"), shared.get("figure")
    if out is not None and not Path(out).resolve().parent.is_dir():  # checked before the computation
        raise EnvironmentFault(out, "no such folder", "a folder that exists")
    with shown(
        shared["progress"], words, lines=chosen.progress in ("lines", "parts"), verbose=shared.get("verbose", False),
        budgets=chosen.progress in ("", "lines"),
    ) as report:  # fmt: skip
        values = _values(chosen, given, shared, files)
        above = _overruled(values, given)
        if chosen.takes("progress"):
            values["progress"] = report.listener if chosen.progress == "parts" else report
        if chosen.takes("drawn"):
            values["drawn"] = figure is not None
        try:
            one = chosen(**values)
        except RobustlabError as error:
            error.hint = error.hint and chosen.hint(error.hint, of_command=True)
            raise
        further, text = {}, ""
        if more is not None:
            further, text = more(one.result, values, {**shared, "named": given, "report": report}, files)
        written = []
        if out:
            typed = _typed(chosen, given, shared, files)
            rl.save(out, chosen.made_of(one.result), provenance_of(words, files, values, given.get("seed"), typed))
            written.append(out)
        rows = [f"written: {file}" for file in written]
        if figure is not None:
            from robustlab.report.drawings import pictures_of

            report("figures")
            results = (one.result, *one.extras.values())
            drawn = save_figures({name: p for result in results for name, p in pictures_of(result, note)}, figure)
            note("\n".join(f"written: {file}" for file in drawn) or "nothing to draw")
            written += drawn
    for remark in dict.fromkeys(one.notes):
        note(remark)
    text = text or above + _text(one).replace("as the controller says", f"as {given.get('controller')} says")
    made = {**_json(one), **({"files": written} if written else {}), **further}
    emit(words, made, "\n".join([text, *rows]), shared["as_json"])
    if getattr(one.result, "interrupted", False):
        raise typer.Exit(EXIT_INTERRUPTED)
    if hasattr(one.result, "require"):
        one.result.require()
    for result in (one.result, *one.extras.values()):
        for status in getattr(result, "statuses", [getattr(result, "status", None)]):
            if status is not None and not status.trustworthy:
                raise typer.Exit(NoTrustworthyNumber.exit_code)
    if getattr(one.result, "met", None) is False:
        raise typer.Exit(EXIT_REQUIREMENT_NOT_MET)


def _text(one: InLoop) -> str:
    tables = [f"{part.title}\n{text_table(part.rows, part.header)}".lstrip() for part in one.parts if part.rows]
    extras = [
        f"{name}  {found}" if isinstance(found, str) else found.report()
        for name, found in one.extras.items() if isinstance(found, str) or (hasattr(found, "facts") and found.facts())
    ]  # fmt: skip
    return "\n\n".join([*([f"loop  {one.loop}"] if one.loop else []), one.result.report(), *tables, *extras])


def _json(one: InLoop) -> Mapping[str, Any]:
    result = one.result
    without = {"series": False} if "series" in signature(result.to_json).parameters else {}
    plain = (str, int, float)
    extras = {
        name: found for name, found in one.extras.items() if isinstance(found, plain) or hasattr(found, "to_json")
    }
    return {**result.to_json(**without), **extras, **({"loop": one.loop} if one.loop else {})}


def _values(chosen: Operation, given: Mapping[str, Any], shared: Mapping[str, Any], files: list[str]) -> dict[str, Any]:
    """Return the given values of the operation's parameters; add the files read to ``files``."""
    found: dict[str, Any] = {}
    things = {p.key: p for p in chosen.parameters if isinstance(p.kind, Thing)}
    # Models first: they define a record's columns and the units of signals.
    for p in sorted(chosen.parameters, key=lambda p: (p.key not in things, isinstance(p.kind, RecordFile))):
        if p.name not in given:
            continue
        if isinstance(p.kind, (Thing, TextFile)):
            value = _read(p, given[p.name], shared, files, found)
        elif isinstance(p.kind, Table) and p.kind.of in things:
            units = _units_of(found.get(things[p.kind.of].name), p.kind.side)
            value = p.kind.read(p.options[0], given[p.name], units)
        else:
            value = p.kind.read(p.options[0], given[p.name])
        if value is not None or p.needed:  # else the function's own default
            found[p.name] = value
    return found


def _overruled(found: dict[str, Any], given: Mapping[str, Any]) -> str:
    """Return a note where ``--feedback`` contradicts the controller, and remove the controller's own sign."""
    sign, K = found.get("sign"), found.get("controller")
    if sign is None or K is None:
        return ""
    from robustlab.feedback import SIGNS, as_controller, without_sign
    from robustlab.signals import Taken, law

    inputs = as_controller(K, "controller").inputs
    if all(s.sign in (0, sign) for s in inputs if isinstance(s, Taken)):
        return ""
    found["controller"] = without_sign(K, "controller")
    word = "negative" if sign < 0 else "positive"
    return f"note: {given['controller']} says {law(inputs)}; --feedback {word} closes {SIGNS[sign]} all the same\n"


def _read(p: Parameter, given: Any, shared: Mapping[str, Any], files: list[str], found: Mapping[str, Any]) -> Any:
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
        extras = next((v for v in found.values() if hasattr(v, "outputs")), None)
        records = [_read_named(reading, extras, name, files, kind.remarks) for name in names]
        return (records or None) if kind.many else records[0] if records else None
    files += [name for name in names if Path(name).is_file()]
    if (kind.reading == "plant" or "plant" in kind.gives) and any(map(runs_code, names)):
        result_alone()  # a user's code may print
    chosen = {key: value for key, value in reading.items() if value}
    things = [kind.load(name, note, **chosen) for name in names]
    return things if kind.many else things[0] if things else None


def _typed(chosen: Operation, given: Mapping[str, Any], shared: Mapping[str, Any], files: Sequence[str]) -> str:
    """Return the arguments but for files: names of plants, and the options that are not the default, as typed."""
    words = []
    for p in chosen.parameters:
        value = given.get(p.name)
        if value not in (None, _as_text(p), []):
            word = "" if isinstance(p.kind, Thing) and not p.kind.option else p.options[-1].lstrip("-")
            texts = value if isinstance(value, list) else [value]
            words += [f"{word} {text}".strip() for text in texts if word or text not in files]
    return ", ".join([*words, *(f"set {text}" for text in shared.get("settings") or ())])


def provenance_of(
    words: str, files: list[str], values: Mapping[str, Any], seed: int | None = None, typed: str = ""
) -> Any:
    """Return the provenance: the files read, and the code of plants."""
    from robustlab.provenance import Provenance, code_of, file_sha256

    code = {file: sha for value in values.values() for file, sha in code_of(value).items()}
    return Provenance.now(words, {f: file_sha256(f) for f in files} | code, seed, typed)


HINT = "name the columns: --inputs u=COLUMN,... --outputs q=COLUMN,..."


def read_record(
    file: str, options: Mapping[str, Any], inputs: str | None, group: str | None = None, remarks: bool = True
) -> rl.Record:
    """Return the record in a file with these inputs and of this group; note conversions of units."""
    units = {}
    for text in options["unit"] or []:
        name, equals, unit = text.partition("=")
        if not (name and equals):
            raise UsageError(f"--unit {text}", "no name and unit", "NAME=UNIT")
        units[name] = unit
    taken, kept = (None if text is None else comma_separated(text) for text in (inputs, options["outputs"]))
    same = {name: options[name] for name in ("clock", "delimiter", "decimal", "allow_gaps")}
    record = rl.Record.read(file, group or options["group"], taken, kept, options["dt"], units=units, **same)
    for name in record.units:
        if name in units and not same_unit(units[name], record.unit(name)):
            note(f"{file}: {name}: converted from {units[name]} to {record.unit(name)}")
    if remarks:
        for line in record.meaning.get("t", "").splitlines():
            note(f"{file}: {line}")
    return record


def _read_named(options: Mapping[str, Any], system: Any, named: str, files: list[str], remarks: bool) -> rl.Record:
    """Return the record ``FILE`` or ``FILE#GROUP``, with the columns of a model; add the file to ``files``."""
    from robustlab.statespace import as_model

    file, mark, group = named.rpartition("#")
    if not mark or Path(named).exists():  # the mark may be part of a name
        file, group = named, None
    files.append(file)
    if system is None:
        return read_record(file, options, options["inputs"], group, remarks)
    model = system if hasattr(system, "inputs") else as_model(system)
    inputs = options["inputs"] or ",".join(s.name for s in model.inputs)
    try:
        record = read_record(file, options, inputs, group, remarks)
    except InputError as error:
        if options["inputs"] is None and error.found.startswith("missing "):
            error.hint = HINT
        raise
    wanted = [s.name for s in model.outputs]
    if options["outputs"] is None and wanted and not set(wanted) & set(record.outputs):
        found = f"no output of the model among {', '.join(record.outputs) or 'none'}"
        raise InputError(file, found, ", ".join(wanted), HINT)
    return record


def _units_of(system: Any, side: str) -> dict[str, str]:
    """Return the units of the parameters of a plant, or of all signals of a plant or model; none of anything else."""
    if side == "parameters":
        return {p.name: p.unit for p in getattr(system, "parameters", {}).values()}
    every = (s for side in ("inputs", "outputs", "states") for s in getattr(system, side, ()))
    return {s.name: s.unit for s in every if hasattr(s, "unit")}


def _given(p: Parameter, alone: bool) -> Given:
    placed = p.kind.option == "*" or (isinstance(p.kind, (Thing, TextFile)) and not p.kind.option)
    positional = placed and (p.needed or getattr(p.kind, "positional", False))
    kind: Any = p.kind.taken
    help_text = p.help if not isinstance(p.kind, Choice) else f"{p.help} One of {', '.join(p.kind.words)}.".strip()
    if positional:
        many = isinstance(p.kind, Thing) and p.kind.many
        metavar = "FILE..." if many else "FILE" if alone and p.kind.option != "*" else p.name.upper()
        option: Any = typer.Argument(help=help_text, metavar=metavar, autocompletion=_offer(p.kind))
        default: Any = Given.empty if p.needed else None
        taken = kind if p.needed else kind | None
        return Given(p.name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[taken, option])
    option = typer.Option(*p.options, help=help_text, metavar=p.kind.metavar, autocompletion=_offer(p.kind))
    if p.needed:
        return Given(p.name, Given.KEYWORD_ONLY, annotation=Annotated[kind, option])
    if isinstance(p.kind, Flag):  # ``--certify`` if off by default, ``--direct/--no-direct`` if on
        first = p.options[0]
        flag = (f"{first}/--no-{first.removeprefix('--')}",) if p.default else p.options
        option = typer.Option(*flag, help=help_text)
    default = _as_text(p)
    if default is None:
        kind = kind | None
    return Given(p.name, Given.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option])


def _as_text(p: Parameter) -> Any:
    if p.default is None or p.default is REQUIRED:
        return None
    annotation = p.kind.taken
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
