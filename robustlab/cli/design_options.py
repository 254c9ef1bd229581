"""Option groups of ``robustlab synth``: channels, signals, weights, what becomes of a design; how words are read."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import FIGURE, emit, note, require_trust, save_drawing, table
from robustlab.cli.offers import one_of
from robustlab.cli.options import JsonOption, OutOption, OutputOptions, frequencies, load_model, names
from robustlab.cli.progress import Display, ProgressOptions
from robustlab.errors import EnvironmentFault, InputError, RobustlabError, UsageError, did_you_mean

if TYPE_CHECKING:
    from robustlab.synthesis.problem.design import Synthesis
    from robustlab.synthesis.problem.partition import GeneralizedPlant


@dataclass(frozen=True)
class ChannelOptions:
    """Which inputs and outputs of a file a design takes, by number or by name."""

    n_meas: Annotated[int | None, typer.Option(help="Number of measurements (the last outputs).")] = None
    n_con: Annotated[int | None, typer.Option(help="Number of controls (the last inputs).")] = None
    measurements: Annotated[str | None, typer.Option(help="Measured outputs by name.")] = None
    controls: Annotated[str | None, typer.Option(help="Control inputs by name.")] = None
    disturbances: Annotated[
        str | None,
        typer.Option("--disturbance-inputs", help="With names: the inputs w; all that are no controls where left out."),
    ] = None
    performance: Annotated[
        str | None,
        typer.Option("--performance-outputs", help="With names: the outputs z; all outputs where left out."),
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
            raise UsageError(
                command, "--disturbance-inputs or --performance-outputs", "--measurements and --controls by name, too"
            )

    def plant(self, command: str, file: str, nominal: bool = False) -> GeneralizedPlant:
        """The generalised plant of a file."""
        from robustlab.synthesis.problem.partition import as_generalized_plant

        found: Any = rl.load(file)
        if nominal:
            if not isinstance(found, rl.UncertainModel):
                raise InputError(file, f"a {type(found).__name__}", "an uncertain model, because of --nominal")
            found = found.nominal
        if self.measurements is None or self.controls is None:
            return as_generalized_plant(found, self.n_meas, self.n_con, command)
        w, z = (None if text is None else names(text) for text in (self.disturbances, self.performance))
        return rl.generalized_plant(found, names(self.measurements), names(self.controls), w, z)


@dataclass(frozen=True)
class LoopChannelOptions:
    """Which inputs and outputs of a plant its controller is connected to."""

    measurements: Annotated[
        str | None, typer.Option(help="Measured outputs by name; the last ones where left out.")
    ] = None
    controls: Annotated[str | None, typer.Option(help="Control inputs by name; the last ones where left out.")] = None

    def plant(self, file: str, K: Any) -> GeneralizedPlant:
        """The generalised plant of the file: by names, or with as many channels at the end as the controller has."""
        from robustlab.synthesis.problem.partition import as_generalized_plant

        if (self.measurements is None) != (self.controls is None):
            raise UsageError("--measurements, --controls", "one of them", "both, or none")
        loaded = rl.load(file)
        if self.measurements is None or self.controls is None:
            return as_generalized_plant(loaded, K.n_inputs, K.n_outputs, file)
        return rl.generalized_plant(loaded, names(self.measurements), names(self.controls))


@dataclass(frozen=True)
class SignalOptions:
    """Which control inputs and outputs of a plain model are used."""

    inputs: Annotated[str | None, typer.Option(help="Control inputs of the model to use.")] = None
    outputs: Annotated[str | None, typer.Option(help="Outputs of the model to control.")] = None

    def model(self, file: str) -> rl.StateSpaceModel:
        """The model in a file with these signals."""
        model = load_model(file)
        if not self.inputs and not self.outputs:
            return model
        sides = (None if not text else names(text) for text in (self.inputs, self.outputs))
        return model.select(*sides)


@dataclass(frozen=True)
class DesignOutput(ProgressOptions):
    """What becomes of a design, and whether its search is told step by step."""

    out: OutOption = None
    figure: Annotated[str | None, typer.Option(help=FIGURE)] = None
    verbose: Annotated[bool, typer.Option("--verbose", help="A line on stderr for each step of the search.")] = False
    as_json: JsonOption = False

    def check(self) -> None:
        """Refuse, before the search, a file that could not be written after it."""
        if self.out is not None and not Path(self.out).resolve().parent.is_dir():
            raise EnvironmentFault(self.out, "no such folder", "a folder that exists")

    def keep(self, command: str, found: Synthesis, file: str, report: Display) -> list[tuple[str, str]]:
        """Store the controller, then draw, while it is shown that this goes on; the rows that say so."""
        rows = OutputOptions(self.out).keep_made(command, found.controller, [file])
        if self.figure is not None:
            report("figures")
            _draw(found, self.figure)
        return rows

    def finish(self, command: str, found: Synthesis, kept: list[tuple[str, str]]) -> None:
        """Print the design with what was kept of it, and leave with the exit code of its status."""
        limits = [line for part in found.details() for (line,) in part.rows]
        rows = found.facts()
        rows += [("" if k else "limits of any controller", line) for k, line in enumerate(limits)]
        emit(command, {**found.to_json(), "limits": limits}, table([*rows, *kept]), self.as_json)
        require_trust(found.status)


@dataclass(frozen=True)
class QuietDesignOutput(DesignOutput):
    """The same of a design that needs no search."""

    verbose: bool = False


@dataclass(frozen=True)
class GaussianOptions:
    """Weights and noises of a linear-quadratic-Gaussian design: a number for all, or a,b,... for each on its own."""

    q: Annotated[str, typer.Option(help="Cost of the states: a number, or one for each: a,b.")] = "1"
    r: Annotated[str, typer.Option(help="Cost of the controls.")] = "1"
    w: Annotated[str, typer.Option(help="Intensity of the noise on the states.")] = "1"
    v: Annotated[str, typer.Option(help="Intensity of the noise on the measurements.")] = "1"
    disturbance: Annotated[
        str | None, typer.Option(help="constant, the frequency of a sinusoid in rad/s, or the file of a filter.")
    ] = None
    at: Annotated[
        str,
        typer.Option(
            "--disturbance-at", help="Where it adds: input or output.", autocompletion=one_of("input", "output")
        ),
    ] = "input"
    channels: Annotated[str | None, typer.Option(help="On which of them: a,b; all.")] = None
    disturbance_noise: Annotated[str, typer.Option(help="Intensity of its noise.")] = "1"
    regulated: Annotated[str | None, typer.Option(help="Outputs that it must leave: a,b; all.")] = None

    def design(self, model: rl.StateSpaceModel) -> Synthesis:
        """The design for a model."""
        import numpy as np

        sizes = (model.n_states, model.n_inputs, model.n_states, model.n_outputs)
        weights = [
            np.diag(np.broadcast_to(_numbers(f"--{name}", getattr(self, name), size), (size,)))
            for name, size in zip("qrwv", sizes, strict=True)
        ]
        text = self.disturbance
        given = text if text is None or text == "constant" else number_or_model(text)
        named = [None if text is None else names(text) for text in (self.channels, self.regulated)]
        noise, at = (
            _numbers("--disturbance-noise", self.disturbance_noise),
            "output" if self.at == "output" else "input",
        )
        if self.at != at:
            raise UsageError("--disturbance-at", repr(self.at), "input or output")
        return rl.lqg(
            model, *weights, disturbance=given, at=at, channels=named[0], disturbance_noise=noise, regulated=named[1]
        )


# --- reading ---------------------------------------------------------------------------------------------------------


def number_or_model(text: str) -> rl.StateSpaceModel | float:
    """A weight: a number, or a file with a model."""
    try:
        return float(text)
    except ValueError:
        return load_model(text)


def _number(where: str, text: str) -> float:
    """A number, or a usage error."""
    try:
        return float(text)
    except ValueError:
        raise UsageError(where, f"{text.strip()!r}", "a number") from None


def _numbers(option: str, text: str, most: int | None = None) -> list[float]:
    """One number, or as many as there are channels."""
    found = [_number(option, part) for part in names(text)]
    if most is not None and len(found) not in (1, most):
        raise UsageError(option, f"{len(found)} numbers", f"one, or {most}")
    return found


def goal_of(text: str) -> tuple[str, dict[str, Any]]:
    """``"tracking:response_time=1,peak=2"`` as a word and its options; ``outputs=a+b`` are names."""
    word, _, rest = text.partition(":")
    options: dict[str, Any] = {}
    for part in names(rest) if rest else []:
        key, found, value = part.partition("=")
        if not found:
            raise UsageError(f"goal {text!r}", repr(part), "key=value")
        try:
            options[key.strip()] = float(value)
        except ValueError:
            listed = word == "tracking" and key.strip() == "outputs"
            options[key.strip()] = value.split("+") if listed else value.strip()
    return word.strip(), options


def limit_of(text: str) -> Any:
    """``"damping=0.5"`` as a limit of poles."""
    from robustlab.synthesis.nonsmooth.design_limits import Bandwidth, Damping, Decay

    known = {"damping": Damping, "decay": Decay, "bandwidth": Bandwidth}
    word, _, value = text.partition("=")
    if word.strip() not in known:
        raise UsageError("--pole-limit", repr(text), f"one of {', '.join(known)}, each =NUMBER")
    return known[word.strip()](_number(f"--pole-limit {word}", value))


def weight_of(option: str, text: str | None, make: Any) -> Any:
    """A number, or the weight that ``key=value,...`` specifies; None where left out."""
    if text is None:
        return None
    if "=" not in text:
        return _number(option, text)
    known = list(signature(make).parameters)
    specification: dict[str, float] = {}
    for part in names(text):
        key, _, value = part.partition("=")
        key = key.strip().replace("-", "_")
        if key not in known:
            raise UsageError(option, f"unknown word {key!r}", f"one of {', '.join(known)}", did_you_mean(key, known))
        at = value if key != "bandwidth" else str(frequencies(f"{option}: {key}", value)[0])
        specification[key] = _number(f"{option}: {key}", at)
    if "order" in specification and specification["order"].is_integer():
        specification["order"] = int(specification["order"])
    required = known[0]
    if required not in specification:
        raise UsageError(option, f"{required} is missing", f"at least {required}=NUMBER")
    return make(**specification)


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
