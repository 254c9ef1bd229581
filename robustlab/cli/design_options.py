"""Option groups of ``robustlab synth``: which channels of a file, and what becomes of the design."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import emit, note, require_trust, save_drawing, table
from robustlab.cli.options import JsonOption, OutOption, OutputOptions, names
from robustlab.errors import EnvironmentFault, InputError, RobustlabError, UsageError

if TYPE_CHECKING:
    from robustlab.statespace import StateSpaceModel
    from robustlab.synthesis.problem.design import Synthesis
    from robustlab.synthesis.problem.partition import GeneralizedPlant

__all__ = ["ChannelOptions", "DesignOutput", "LoopChannelOptions", "QuietDesignOutput", "SignalOptions"]


@dataclass(frozen=True)
class ChannelOptions:
    """Which inputs and outputs of a file a design takes, by number or by name."""

    n_meas: Annotated[int | None, typer.Option("--n-meas", help="Number of measurements (the last outputs).")] = None
    n_con: Annotated[int | None, typer.Option("--n-con", help="Number of controls (the last inputs).")] = None
    measurements: Annotated[str | None, typer.Option("--measurements", help="Measured outputs by name: a,b.")] = None
    controls: Annotated[str | None, typer.Option("--controls", help="Control inputs by name: a,b.")] = None
    disturbances: Annotated[
        str | None,
        typer.Option("--disturbances", help="With names: the inputs w; all that are no controls where left out."),
    ] = None
    performance: Annotated[
        str | None, typer.Option("--performance", help="With names: the outputs z; all outputs where left out.")
    ] = None

    def check(self, command: str) -> None:
        """Refuse channels that are not given, or given twice."""
        by_name, by_number = (self.measurements, self.controls), (self.n_meas, self.n_con)
        named, counted = None not in by_name, None not in by_number
        halves = any(by_name) != named or any(n is not None for n in by_number) != counted
        if halves or named == counted:
            expected = "either --n-meas and --n-con, or --measurements and --controls"
            raise UsageError(command, "channels are not given", expected)
        if counted and (self.disturbances or self.performance):
            raise UsageError(command, "--disturbances or --performance", "--measurements and --controls by name, too")

    def plant(self, command: str, file: str, nominal: bool = False) -> GeneralizedPlant:
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
            return as_generalized_plant(found, self.n_meas, self.n_con, command)
        w, z = (None if text is None else names(text) for text in (self.disturbances, self.performance))
        return generalized_plant(found, names(self.measurements), names(self.controls), w, z)


@dataclass(frozen=True)
class LoopChannelOptions:
    """Which inputs and outputs of a plant its controller is connected to."""

    measurements: Annotated[
        str | None,
        typer.Option("--measurements", help="Measured outputs by name, a,b; the last outputs where left out."),
    ] = None
    controls: Annotated[
        str | None, typer.Option("--controls", help="Control inputs by name, a,b; the last inputs where left out.")
    ] = None

    def plant(self, file: str, K: Any) -> GeneralizedPlant:
        """The generalised plant of the file: by names, or with as many channels at the end as the controller has."""
        from robustlab.storage import load
        from robustlab.synthesis.problem.partition import as_generalized_plant, generalized_plant

        if (self.measurements is None) != (self.controls is None):
            raise UsageError("--measurements, --controls", "one of them", "both, or none")
        loaded = load(file)
        if self.measurements is None or self.controls is None:
            return as_generalized_plant(loaded, K.n_inputs, K.n_outputs, file)
        return generalized_plant(loaded, names(self.measurements), names(self.controls))


@dataclass(frozen=True)
class SignalOptions:
    """Which control inputs and outputs of a plain model are used."""

    inputs: Annotated[str | None, typer.Option("--inputs", help="Control inputs of the model to use: a,b.")] = None
    outputs: Annotated[str | None, typer.Option("--outputs", help="Outputs of the model to control: a,b.")] = None

    def model(self, file: str) -> StateSpaceModel:
        """The model in a file with these signals."""
        from robustlab.statespace import as_model
        from robustlab.storage import load

        model = as_model(load(file), file)
        if not self.inputs and not self.outputs:
            return model
        sides = (None if not text else names(text) for text in (self.inputs, self.outputs))
        return model.select(*sides)


@dataclass(frozen=True)
class DesignOutput:
    """What becomes of a design, and whether its search is told step by step."""

    out: OutOption = None
    figure: Annotated[
        str | None,
        typer.Option("--figure", help="Figures to write: NAME and NAME-..., each as SVG and PNG.", show_default=False),
    ] = None
    verbose: Annotated[bool, typer.Option("--verbose", help="A line on stderr for each step of the search.")] = False
    as_json: JsonOption = False

    def check(self) -> None:
        """Refuse, before the search, a file that could not be written after it."""
        if self.out is not None and not Path(self.out).resolve().parent.is_dir():
            raise EnvironmentFault(self.out, "no such folder", "a folder that exists")

    def finish(self, command: str, found: Synthesis, file: str) -> None:
        """Print the design, store the controller, draw, and leave with the exit code of its status."""
        from robustlab.synthesis.problem.performance_limits import limits_in_words

        limits = limits_in_words(found)
        rows = found.summary()
        rows += [("" if k else "limits of any controller", line) for k, line in enumerate(limits)]
        rows += OutputOptions(self.out).keep_made(command, found.controller, [file])
        if self.figure is not None:
            _draw(found, self.figure)
        emit(command, {**found.to_json(), "limits": limits}, table(rows), self.as_json)
        require_trust(found.status)


@dataclass(frozen=True)
class QuietDesignOutput(DesignOutput):
    """The same of a design that needs no search."""

    verbose: bool = False


def _draw(found: Synthesis, figure: str) -> None:
    """Write all figures that there are of a design."""
    from robustlab.report.design_figures import pictures

    for suffix, make in pictures(found).items():
        try:
            drawing = make()
        except RobustlabError as error:
            note(f"no figure {suffix or 'of the loop'}: {error}")
            continue
        save_drawing(drawing, figure, f"-{suffix}" if suffix else "")
