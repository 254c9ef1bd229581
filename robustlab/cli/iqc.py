"""``robustlab iqc``: proved gain with nonlinear, time-varying and uncertain blocks; static anti-windup."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

import typer

import robustlab as rl
from robustlab.cli.console import emit, note, require_trust
from robustlab.cli.margins import ControllerOptions
from robustlab.cli.offers import plant_or_file
from robustlab.cli.options import EffortOptions, OutputOptions, assignments, ends, grouped, load_model, names, put_once
from robustlab.cli.progress import ProgressOptions
from robustlab.errors import UsageError

app = typer.Typer(
    help="Proved gain with nonlinear and time-varying blocks.", no_args_is_help=True, add_completion=False
)

OrderOption = Annotated[int, typer.Option("--filter-order", help="Order of the multipliers' filters, 0..8.")]


@dataclass(frozen=True)
class BlockOptions:
    """What the blocks are, and between which signals the gain is asked for."""

    nature: Annotated[
        list[str] | None,
        typer.Option(
            help="What a block is, NAME=WORD:NUMBERS, or OUTPUT:INPUT=... between two signals: varying[:RATE], "
            "saturation, dead-zone[:SIZE:REACH], friction:LEVEL:SPEED, sector:LOW:HIGH, slope:LOW:HIGH or "
            "odd-slope:LOW:HIGH; repeatable."
        ),
    ] = None
    inputs: Annotated[str | None, typer.Option(help="Inputs to keep.")] = None
    outputs: Annotated[str | None, typer.Option(help="Outputs to keep.")] = None
    stability: Annotated[bool, typer.Option("--stability", help="The margin of stability instead of the gain.")] = False


@dataclass(frozen=True)
class EffectOptions(ControllerOptions):
    """The loop of a plant with effects."""

    amplitude: Annotated[
        list[str] | None, typer.Option(help="Bound of the signal at an effect's place, NAME=VALUE; repeatable.")
    ] = None
    stick_speed: Annotated[
        list[str] | None, typer.Option(help="Speed below which dry friction is creep, JOINT=VALUE; repeatable.")
    ] = None


@app.command()
@grouped
def gain(
    *,
    file: Annotated[
        str,
        typer.Argument(
            help="Uncertain model, model, or a plant with effects: HDF5 file.",
            metavar="FILE",
            autocompletion=plant_or_file,
        ),
    ],
    blocks: BlockOptions,
    effects: EffectOptions,
    order: OrderOption = 2,
    effort: EffortOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Worst L2 gain, proved for blocks that are nonlinear, vary with time, or are uncertain.

    Example: robustlab iqc gain loop.h5 --nature y:u=saturation --nature k=varying:0.5
    """
    from robustlab.dynamics.extended.extended_plant import ExtendedPlant
    from robustlab.iqc.nature import natures_in_words

    thing = rl.load(file)
    said = head = ""
    with progress.shown("iqc gain"):
        if isinstance(thing, ExtendedPlant):
            result: Any = _effects(thing, blocks, effects, order, effort)
        else:
            if effects.amplitude or effects.stick_speed:
                found, expected = f"--amplitude or --stick-speed for a {type(thing).__name__}", "a plant with effects"
                raise UsageError("iqc gain", found, expected, "--nature says what a block is")
            thing, said, head = effects.closed(thing, "iqc gain", file)
            known = [b.name for b in thing.blocks] if isinstance(thing, rl.UncertainModel) else []
            given: dict[str, str] = {}
            for text in blocks.nature or []:
                put_once(given, "--nature", text, *_pair(text))
            nature = natures_in_words(given, "--nature", known)
            options: dict[str, Any] = {"order": order, **vars(effort)}
            if blocks.stability:
                result = rl.robust_stability(thing, natures=nature, **options)
            else:
                result = rl.peak_gain(
                    thing, natures=nature, inputs=_names(blocks.inputs), outputs=_names(blocks.outputs), **options
                )
    output.finish("iqc gain", result, f"{head}{result.report()}", **({"loop": said} if said else {}))


def _effects(plant: Any, blocks: BlockOptions, effects: EffectOptions, order: int, effort: EffortOptions) -> Any:
    from robustlab.closing import closing

    if effects.controller is None:
        raise UsageError("iqc gain", "a plant with effects without --controller", "the loop that it stands in")
    if blocks.nature or blocks.inputs or blocks.stability:
        raise UsageError("iqc gain", "--nature, --inputs or --stability for a plant with effects", "none of them",
                         "its effects say what they are")  # fmt: skip
    k, sign, remark = effects.read("iqc gain")
    if remark:
        note(remark)
    outputs = _names(blocks.outputs)
    sign = closing(plant.plant.state_space().select(None, outputs), k, sign, "iqc gain", None).sign
    return rl.peak_gain(
        plant, k, outputs=outputs, amplitude=assignments("--amplitude", effects.amplitude),
        stick_speed=assignments("--stick-speed", effects.stick_speed), sign=sign, order=order, **vars(effort),
    )  # fmt: skip


def _names(text: str | None) -> list[str] | None:
    return None if text is None else names(text)


def _pair(text: str) -> tuple[str, str]:
    name, equals, word = text.partition("=")
    if not (name and equals and word):
        raise UsageError(f"--nature {text}", "no name and word", "NAME=WORD:NUMBERS")
    return name, word


@app.command("anti-windup")
@grouped
def anti_windup(
    *,
    plant: Annotated[str, typer.Argument(help="Plant: HDF5 or .mat file; u and y are its last inputs and outputs.")],
    controller: Annotated[str, typer.Argument(help="Controller u = K y: HDF5 or .mat file.")],
    limits: Annotated[
        list[str] | None,
        typer.Option("--saturation", help="Limits of a control signal, u=-10:10; repeatable. Left out: -1:1."),
    ] = None,
    reach: Annotated[
        float,
        typer.Option(
            help="Bound of the demanded signal as a multiple of its limit; needed where the plant is not stable."
        ),
    ] = math.inf,
    direct: Annotated[
        bool, typer.Option("--correct-outputs", help="Correct the outputs too, an algebraic loop.")
    ] = False,
    dt: Annotated[
        float | None, typer.Option(help="With --code: sample time in s of the controller that is written.")
    ] = None,
    code: Annotated[str | None, typer.Option(help="C file to write: the controller held, with its gain.")] = None,
    order: OrderOption = 2,
    effort: EffortOptions,
    progress: ProgressOptions,
    output: OutputOptions,
) -> None:
    """Static anti-windup gain of least proved L2 gain, beside back-calculation and none.

    Example: robustlab iqc anti-windup motor.h5 pi.h5 --saturation u=-10:10 --out windup.h5
    """
    from robustlab.signals import law

    K = load_model(controller)
    given = ends("--saturation", limits)
    unknown = [name for name in given if name not in K.output_names]
    if unknown:
        raise UsageError(f"--saturation {unknown[0]}", "no such control signal", f"one of {', '.join(K.output_names)}")
    pairs = [given.get(name, (-1.0, 1.0)) for name in K.output_names]
    if (code is None) != (dt is None):
        raise UsageError("iqc anti-windup", "one of --code and --dt", "both, or none")
    with progress.shown("iqc anti-windup"):
        result = rl.anti_windup(load_model(plant), K, pairs, reach, direct, order=order, **vars(effort))
    output.keep(result)
    said = f"{law(K.inputs)}, as {controller} says" if law(K.inputs) else f"u = K y; {controller} does not say its sign"
    text = f"loop  {said}\n\n{result.summary()}"
    if code is not None and dt is not None:
        held, back = result.sampled(dt)
        rl.export_controller(code, held, saturation=dict(zip(K.output_names, pairs, strict=True)), anti_windup=back)
        text += f"\nwritten: {code}"
    emit("iqc anti-windup", {**result.to_json(), "loop": said}, text, output.as_json)
    require_trust(result.status)
