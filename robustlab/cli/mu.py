"""``robustlab mu``: stability margin, robust performance and worst-case gain of an uncertain model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

import robustlab as rl
from robustlab.cli.console import note, save_drawing, table
from robustlab.cli.margins import ControllerOptions
from robustlab.cli.options import EffortOption, OutputOptions, SeedOption, TimeLimitOption, frequencies, grouped
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import InputError, UsageError

if TYPE_CHECKING:
    from robustlab.mu_analysis import Margin, WorstCaseGain
    from robustlab.mu_analysis.axis.robust_gain import RobustGain

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None, add_completion=False)

DELTA = ("block", "delta", "parameter")


@dataclass(frozen=True)
class VoiceOptions:
    """Who else is asked whether the bounds are right."""

    certify: Annotated[
        bool, typer.Option("--certify", help="Confirm the scalings in ball arithmetic (needs robustlab[certify]).")
    ] = False
    cross_check: Annotated[
        bool, typer.Option("--cross-check", help="Ask SLICOT too (AB13MD, AB13DD); where it contradicts, exit code 4.")
    ] = False


@dataclass(frozen=True)
class QuestionOptions:
    """What is asked of the model, and of which part of it."""

    gain: Annotated[bool, typer.Option("--gain", help="Worst-case gain from inputs to outputs instead.")] = False
    performance: Annotated[
        bool, typer.Option("--performance", help="Robust performance margin of weighted inputs and outputs instead.")
    ] = False
    level: Annotated[
        float | None, typer.Option(help="How much of the set keeps the gain below this level, instead.")
    ] = None
    frequency: Annotated[
        str | None,
        typer.Option(
            help="Margin, or --gain, at these frequencies only, rad/s: 1,10; or 2Hz. Frequency data need none."
        ),
    ] = None
    inputs: Annotated[str | None, typer.Option(help="Inputs to keep for gain or performance: a,b.")] = None
    outputs: Annotated[str | None, typer.Option(help="Outputs to keep for gain or performance: a,b.")] = None

    def check_at(self, voices: VoiceOptions, shown: ShownOptions) -> None:
        """Refuse what belongs to the whole axis, where frequencies are given."""
        asked = {
            "--performance": self.performance,
            "--level": self.level is not None,
            "--certify": voices.certify,
            "--cross-check": voices.cross_check,
            "--intervals": shown.intervals,
        }
        found = [name for name, is_given in asked.items() if is_given]
        if found:
            raise UsageError("mu", f"{found[0]} at given frequencies", "the margin, or --gain")

    def check(self, voices: VoiceOptions) -> None:
        """Refuse what does not belong together."""
        asked = [f"--{name}" for name in ("gain", "performance", "level") if getattr(self, name) not in (False, None)]
        if voices.certify and asked:
            raise UsageError("mu", f"--certify with {asked[0]}", "the stability margin")
        if voices.cross_check and (self.performance or self.level is not None):
            raise UsageError("mu", f"--cross-check with {asked[-1]}", "the stability margin, or --gain")
        if len(asked) > 1:
            raise UsageError("mu", " and ".join(asked), "one of them")
        if (self.inputs or self.outputs) and not asked:
            raise UsageError(
                "mu", "--inputs or --outputs without --gain, --performance or --level", "one of these, too"
            )


@dataclass(frozen=True)
class ProofOptions:
    """How close the bounds are to come, and at what expense."""

    tolerance: Annotated[
        float, typer.Option(help="Relative gap of the bounds that branch and bound aims at; inf: none.")
    ] = 0.01
    accuracy: Annotated[float, typer.Option(help="Relative distance to the best margin that D, G can prove.")] = 3e-5
    effort: EffortOption = 1.0
    time_limit: TimeLimitOption = None


@dataclass(frozen=True)
class ShownOptions:
    """What is shown beside the numbers."""

    intervals: Annotated[bool, typer.Option("--intervals", help="Print the proved frequency intervals.")] = False
    figure: Annotated[
        str | None, typer.Option(help="Figures to write: NAME (bounds), NAME-shares, NAME-replay, SVG and PNG.")
    ] = None


@app.command()
@grouped
def mu(
    *,
    file: Annotated[str, typer.Argument(help="HDF5 file with an uncertain model, or with frequency data.")],
    loop: ControllerOptions,
    question: QuestionOptions,
    proof: ProofOptions,
    shown: ShownOptions,
    voices: VoiceOptions,
    seed: SeedOption = 0,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Robust stability margin (1 / mu) over the whole frequency axis, with the critical Delta.

    With --frequency, and for a file with frequency data: at these frequencies, and nothing is claimed between them.

    Example: robustlab mu motor-uncertain.h5 --intervals --out margin.h5
    """
    question.check(voices)
    if not 0 < proof.accuracy < 1 or not proof.tolerance > 0:
        found = f"accuracy {proof.accuracy}, tolerance {proof.tolerance}"
        raise InputError("mu", found, "0 < accuracy < 1, a positive tolerance")
    options: dict[str, Any] = {**vars(proof), "seed": seed}
    uncertain, closed, head = _uncertain(file, loop, question.inputs, question.outputs)
    if question.frequency is not None or isinstance(uncertain, rl.UncertainFrequencyData):
        question.check_at(voices, shown)
        with progress.shown("mu"):
            found = _at_frequencies(uncertain, question, shown, seed)
        output.finish("mu", found, f"{head}{found.report()}", **closed)
        return
    with progress.shown("mu"):
        if question.gain:
            del options["accuracy"]
            result, text = _worst_gain(uncertain, options, shown)
        elif question.level is not None:
            del options["accuracy"]
            result, text = _robust_gain(uncertain, question.level, options, shown)
        else:
            result, text = _margin(uncertain, question.performance, options, shown)
        text, more, trusted = f"{head}{text}", dict(closed), True
        if voices.certify:
            from robustlab.mu_analysis.axis.margin import margin_in_balls

            balls = margin_in_balls(uncertain, cast("Margin", result))
            text += f"\nball arithmetic: {balls.proved} of {balls.tried} inequalities of the proved intervals confirmed"
            more["balls"], trusted = balls, balls.proved == balls.tried
        if voices.cross_check:
            from robustlab.mu_analysis.cross_check import cross_check

            check = cross_check(uncertain, cast("Margin | WorstCaseGain", result))
            text += f"\nSLICOT: {check.said}"
            more["cross_check"], trusted = check, trusted and check.status.trustworthy
    output.finish("mu", result, text, **more)
    if not trusted:
        raise typer.Exit(4)


def _at_frequencies(uncertain: Any, question: QuestionOptions, shown: ShownOptions, seed: int) -> Any:
    """Margin or gain at frequencies; drawn where a figure is asked for."""
    points = None if question.frequency is None else frequencies("--frequency", question.frequency)
    asked: Any = rl.peak_gain if question.gain else rl.robust_stability
    found = asked(uncertain, frequency=points, seed=seed)
    if shown.figure is not None:
        from robustlab.report.robustness_figures import bounds_at

        save_drawing(bounds_at(found), shown.figure)
    return found


def _uncertain(
    file: str, loop: ControllerOptions, inputs: str | None, outputs: str | None
) -> tuple[Any, dict[str, Any], str]:
    """The set, closed where a controller is given; the loop as JSON says it, and as the text begins."""
    uncertain: Any = rl.load(file)
    if not isinstance(uncertain, (rl.UncertainFrequencyData, rl.UncertainModel)):
        return _chosen(uncertain, file, inputs, outputs), {}, ""
    uncertain, said, head = loop.closed(uncertain, "mu", file)
    return _chosen(uncertain, file, inputs, outputs), {"loop": said} if said else {}, head


def _chosen(uncertain: Any, file: str, inputs: str | None, outputs: str | None) -> Any:
    if isinstance(uncertain, rl.UncertainFrequencyData):
        sides = (uncertain.outputs, outputs), (uncertain.inputs, inputs)
        return uncertain[tuple(given.split(",") if given else [s.name for s in side] for side, given in sides)]
    if not isinstance(uncertain, rl.UncertainModel):
        raise InputError(
            file, f"a {type(uncertain).__name__}", "an uncertain model", "robustlab uncertain build --help"
        )
    if inputs or outputs:
        return uncertain.select(inputs.split(",") if inputs else None, outputs.split(",") if outputs else None)
    return uncertain


def _grid(uncertain: rl.UncertainModel, figure: str | None) -> Any:
    """Frequencies for the curves of a figure; none where nothing is drawn."""
    from robustlab.linear_analysis.frequency import default_grid

    return default_grid(uncertain.M, 60) if figure is not None and uncertain.M.n_states else None


def _margin(
    uncertain: rl.UncertainModel, performance: bool, options: dict[str, Any], shown: ShownOptions
) -> tuple[Margin, str]:
    analyse: Any = rl.robust_performance if performance else rl.robust_stability
    margin: Margin = analyse(uncertain, omega=_grid(uncertain, shown.figure), **options)
    if shown.figure is not None:
        _draw(uncertain, margin, shown.figure, performance)
    proved = margin.proved_intervals()
    intervals = f"\n\n{proved.title}\n{table(proved.rows, proved.header)}" if shown.intervals else ""
    return margin, f"{margin.report()}{intervals}"


def _worst_gain(uncertain: rl.UncertainModel, options: dict[str, Any], shown: ShownOptions) -> tuple[Any, str]:
    worst: Any = rl.peak_gain(uncertain, omega=_grid(uncertain, shown.figure), **options)
    if shown.figure is not None:
        from robustlab.report.robustness_figures import gain_figure

        save_drawing(gain_figure(worst), shown.figure)
    text = worst.report()
    if shown.intervals:
        title, header, rows = worst.proved()
        text += f"\n\n{title}\n{table(rows, header)}"
    return worst, text


def _robust_gain(
    uncertain: rl.UncertainModel, level: float, options: dict[str, Any], shown: ShownOptions
) -> tuple[RobustGain, str]:
    if shown.intervals or shown.figure is not None:
        raise UsageError("mu", "--intervals or --figure with --level", "--gain for the intervals of a worst-case gain")
    found = rl.robust_gain(uncertain, level, **options)
    return found, found.report()


def _draw(uncertain: rl.UncertainModel, margin: Margin, figure: str, performance: bool) -> None:
    from robustlab.mu_analysis.axis.critical_delta import replay
    from robustlab.report.robustness_figures import mu_figure, replay_figure, shares_figure

    save_drawing(mu_figure(margin), figure)
    if margin.shares:
        save_drawing(shares_figure(margin.shares), figure, "-shares")
    if performance or not margin.delta or not uncertain.outputs:
        return
    try:
        shown = replay(uncertain, margin)
    except rl.RobustlabError as error:
        note(f"no replay: {error}")
        return
    save_drawing(replay_figure(shown), figure, "-replay")
