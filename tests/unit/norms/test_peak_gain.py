"""`rl.peak_gain` of every kind of system: the class of the result, and refused options with their hints."""

import pytest
import shown_objects as made

import robustlab as rl
from robustlab.norms import PeakGain

LAG = rl.tf([1.0], [1.0, 1.0])
ROUGH = rl.with_effects(rl.plant("servo-axis"), {"input-saturation": {"u_max": 10.0}})


@pytest.mark.parametrize(
    ("system", "options", "kind"),
    [
        (LAG, {}, "HinfNorm"),
        (LAG @ rl.delay(0.1), {}, "DelayGain"),
        (made.first_order(), {}, "WorstCaseGain"),
        (made.first_order(), {"frequency": [0.5, 1.0]}, "GainAt"),
        (LAG @ rl.delay(0.1), {"frequency": [0.5, 1.0]}, "GainAt"),
        (made.first_order(), {"natures": {"pole": rl.Varying(0.1)}, "order": 0}, "IqcGain"),
        (rl.LPVModel({"a": [1.0, 4.0]}, [LAG, LAG]), {}, "LPVGain"),
    ],
)
def test_each_kind_has_one_class_of_bounds(system, options, kind):
    found = rl.peak_gain(system, **options)
    assert isinstance(found, PeakGain)
    assert type(found).__name__ == kind
    assert found.lower <= found.upper * (1 + 1e-9)
    assert set(found.numbers()) <= {*found.to_json(), "value"}
    assert found.facts()[0][0] == "largest gain"
    assert found.headline()


def test_channels_are_chosen_by_name():
    both = [[1.0], [3.0]] @ LAG
    last = both.outputs[-1].name
    assert rl.peak_gain(both, outputs=[last]).upper == pytest.approx(3.0, rel=1e-5)
    assert rl.peak_gain(both, outputs=[last], frequency=[0.0]).upper == pytest.approx(3.0, rel=1e-5)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: rl.peak_gain(made.first_order(), band=(1.0, 2.0)), "band: given for an uncertain model, expected it"),
        (lambda: rl.peak_gain(LAG, LAG), r"close the loop first: G.feedback\(K\)"),
        (lambda: rl.peak_gain(LAG, lyapunov="constant"), "expected it for an LPV model"),
        (lambda: rl.peak_gain(LAG, time_limit=1.0), "an uncertain model, blocks with natures, an LPV model"),
        (lambda: rl.peak_gain(made.first_order(), norm="hinf"), "norm: given for an uncertain model"),
        (lambda: rl.peak_gain(LAG, norm="h2"), "'hinf' or 'linf'"),
        (lambda: rl.peak_gain(LAG, norm="hinf", band=(1.0, 2.0)), "norm='linf': the peak in the band"),
        (lambda: rl.peak_gain(ROUGH), "controller: none for a plant"),
    ],
)
def test_an_option_of_another_kind_is_refused_with_a_hint(call, text):
    with pytest.raises(rl.InputError, match=text) as caught:
        call()
    assert caught.value.where.startswith("peak_gain")
