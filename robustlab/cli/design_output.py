"""What the ``synth`` commands share: which channels, where the search stands, the result, its file and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import emit, note, table
from robustlab.errors import EnvironmentFault, InputError, RobustlabError, UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robustlab.synthesis.problem.design import Synthesis
    from robustlab.synthesis.problem.partition import GeneralizedPlant

FileArgument = Annotated[str, typer.Argument(help="HDF5 or .mat file.", show_default=False)]
NMeasOption = Annotated[int | None, typer.Option("--n-meas", help="Number of measurements (the last outputs).")]
NConOption = Annotated[int | None, typer.Option("--n-con", help="Number of controls (the last inputs).")]
MeasurementsOption = Annotated[str | None, typer.Option("--measurements", help="Measured outputs by name: a,b.")]
ControlsOption = Annotated[str | None, typer.Option("--controls", help="Control inputs by name: a,b.")]
DisturbancesOption = Annotated[
    str | None,
    typer.Option("--disturbances", help="With names: the inputs w; all that are no controls where left out."),
]
PerformanceOption = Annotated[
    str | None, typer.Option("--performance", help="With names: the outputs z; all outputs where left out.")
]
NominalOption = Annotated[
    bool, typer.Option("--nominal", help="Of an uncertain file: without its perturbation channels, at Delta = 0.")
]
GammaRelOption = Annotated[
    float,
    typer.Option("--gamma-rel", help="Allowed ratio to the smallest gamma; within it the slowest controller wins."),
]
FigureOption = Annotated[
    str | None,
    typer.Option("--figure", help="Figures to write: NAME and NAME-..., each as SVG and PNG.", show_default=False),
]
VerboseOption = Annotated[bool, typer.Option("--verbose", help="A line on stderr for each step of the search.")]


def names(text: str) -> list[str]:
    """``"a, b"`` as ``["a", "b"]``."""
    return [part.strip() for part in text.split(",") if part.strip()]


@dataclass(frozen=True)
class Channels:
    """Which inputs and outputs of a file a command was told to take, by number or by name."""

    command: str
    n_meas: int | None
    n_con: int | None
    measurements: str | None
    controls: str | None
    disturbances: str | None
    performance: str | None

    def __post_init__(self) -> None:
        by_name, by_number = (self.measurements, self.controls), (self.n_meas, self.n_con)
        named, counted = None not in by_name, None not in by_number
        halves = any(by_name) != named or any(n is not None for n in by_number) != counted
        if halves or named == counted:
            expected = "either --n-meas and --n-con, or --measurements and --controls"
            raise UsageError(self.command, "channels are not given", expected)
        if counted and (self.disturbances or self.performance):
            raise UsageError(
                self.command, "--disturbances or --performance", "--measurements and --controls by name, too"
            )

    def plant(self, file: str, nominal: bool = False) -> GeneralizedPlant:
        """The generalised plant of a file."""
        from robustlab.storage import load
        from robustlab.synthesis.problem.partition import as_generalized_plant, generalized_plant
        from robustlab.uncertainty.lft import UncertainModel

        found: Any = load(file)
        if nominal:
            if not isinstance(found, UncertainModel):
                raise InputError(file, f"a {type(found).__name__}", "an uncertain model, because of --nominal")
            found = found.nominal
        if self.measurements is None or self.controls is None:
            return as_generalized_plant(found, self.n_meas, self.n_con, self.command)
        w, z = (None if text is None else names(text) for text in (self.disturbances, self.performance))
        return generalized_plant(found, names(self.measurements), names(self.controls), w, z)


def check_target(out: str | None) -> None:
    """Refuse, before the search, a file that could not be written after it."""
    from pathlib import Path

    if out is not None and not Path(out).resolve().parent.is_dir():
        raise EnvironmentFault(out, "no such folder", "a folder that exists")


def rows_of_blocks(text: str) -> list[list[int]]:
    """``"-2,0; 2,2"`` as the rows of `robustlab.mu`."""
    rows: list[list[int]] = []
    for part in text.split(";"):
        try:
            row = [int(number) for number in part.split(",")]
        except ValueError:
            row = []
        if len(row) != 2:
            expected = 'rows "r,c" separated by ";": -r,0 real repeated r times, r,0 complex repeated, r,c a full block'
            raise UsageError("--blocks", repr(part.strip()), expected)
        rows.append(row)
    return rows


def finish(command: str, found: Synthesis, file: str, out: str | None, figure: str | None, as_json: bool) -> None:
    """Print the design, store the controller, draw, and leave with the exit code of its status."""
    from robustlab.synthesis.problem.performance_limits import limits_in_words

    limits = limits_in_words(found)
    rows = found.summary()
    rows += [("" if k else "limits of any controller", line) for k, line in enumerate(limits)]
    if out is not None:
        from robustlab.provenance import Provenance, file_sha256
        from robustlab.storage import save

        save(out, found.controller, Provenance.now(command, {file: file_sha256(file)}))
        rows.append(("written", out))
    if figure is not None:
        draw(found, figure)
    emit(command, {**found.to_json(), "limits": limits}, table(rows), as_json)
    if not found.status.trustworthy:
        raise typer.Exit(4)


def draw(found: Synthesis, figure: str) -> None:
    """Write all figures that there are of a design."""
    from robustlab.report.design_pictures import pictures

    for suffix, make in pictures(found).items():
        try:
            drawing = make()
        except RobustlabError as error:
            note(f"no figure {suffix or 'of the loop'}: {error}")
            continue
        _save(drawing, figure, f"-{suffix}" if suffix else "")


def _save(drawing: Figure, path: str, suffix: str) -> None:
    from pathlib import Path

    from robustlab.report.figures import save_figure

    target = Path(path)
    if not target.stem:
        raise InputError("--figure", repr(path), "a name, for example design.svg")
    for made in save_figure(drawing, target.parent, target.stem + suffix):
        note(f"written: {made}")


def number(where: str, text: str) -> float:
    """A number, or a usage error."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(where, f"{text.strip()!r}", "a number") from None


def weight(option: str, text: str | None, make: Any) -> Any:
    """A number, or the weight that ``key=value,...`` specifies; None where left out."""
    import inspect

    from robustlab.errors import did_you_mean

    if text is None:
        return None
    if "=" not in text:
        return number(option, text)
    known = list(inspect.signature(make).parameters)
    specification: dict[str, float] = {}
    for part in names(text):
        key, _, value = part.partition("=")
        key = key.strip().replace("-", "_")
        if key not in known:
            raise UsageError(option, f"unknown word {key!r}", f"one of {', '.join(known)}", did_you_mean(key, known))
        specification[key] = number(f"{option}: {key}", value)
    if "order" in specification and specification["order"].is_integer():
        specification["order"] = int(specification["order"])
    required = known[0]
    if required not in specification:
        raise UsageError(option, f"{required} is missing", f"at least {required}=NUMBER")
    return make(**specification)
