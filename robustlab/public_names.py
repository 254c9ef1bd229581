"""Lazy import of the names of a package, so that a command loads only the modules it uses; hints for unknown names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any

from robustlab.errors import did_you_mean


def lazily(package: str, names: Mapping[str, str]) -> tuple[list[str], Callable[[str], Any]]:
    """Return ``__all__`` and ``__getattr__`` of a package; ``names``: module -> its names, separated by spaces."""
    module_of = {name: module for module, words in names.items() for name in words.split()}

    def get(name: str) -> Any:
        if name in module_of:
            return getattr(import_module(f"{package}.{module_of[name]}"), name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return list(module_of), get


# Name here -> names of MATLAB, python-control and robustlab 0.1 and 0.2; see docs/coming-from.
NAMES = {
    "rl.ss": "StateSpace zpk2ss",
    "rl.tf": "TransferFunction tf2ss pid",
    "rl.frequency_data": "frd FrequencyResponseData ufrd",
    "rl.UncertainModel": "uss umat ureal ucomplex ultidyn",
    "rl.sample(set, n)": "usample gridureal",
    "set.evaluate({name: value})": "usubs",
    "rl.connect": "sumblk sysic interconnect feedback",
    "rl.lft": "star",
    "rl.connect, or G @ [[1, 0]] + H @ [[0, 1]] for [G, H] and [[1], [0]] @ G + [[0], [1]] @ H for [G; H]": (
        "append beside stacked"
    ),
    "rl.cover; rl.overbound for a weight": "ucover fitmagfrd",
    "rl.robust_stability": "robstab robuststab",
    "rl.robust_stability of the set with one full block, or rl.peak_gain": "small_gain",
    "rl.robust_performance": "robustperf",
    "rl.robust_gain": "robgain",
    "rl.peak_gain": "wcgain hinfnorm hinf_norm linfnorm linf_norm getPeakGain system_norm norm iqc_gain lpv_gain",
    "rl.disk_margin": "diskmargin loopmargin disk_margins",
    "rl.robust_stability of the set with a disk block in its loop": "wcdiskmargin worst_case_disk_margin",
    "rl.classical_margins": "allmargin margin",
    "rl.mu": "mussv skew_mu",
    "rl.robust_stability, which a member without a solution fails": "well_posedness",
    "rl.cover(models, form).conservatism": "conservatism",
    "rl.gap": "gapmetric",
    "rl.coprime_margin": "ncfmargin",
    "rl.loop_functions": "loopsens",
    "rl.hinf": "hinfsyn",
    "rl.h2": "h2syn lqg",
    "rl.mixsyn": "augw",
    "rl.peak_gain(2 * (1 + G) ** -1 - 1), at most 1 where G is passive": "passivity isPassive ispassive",
    "rl.ncf": "ncfsyn loopsyn",
    "rl.dk": "musyn dksyn",
    "rl.fixed_structure": "hinfstruct",
    "rl.tune": "systune",
    "rl.reduce_model": "reduce balred balancmr modred balanced_truncation balanced_reduction hankelmr",
    "rl.reduce_model(model, order).hankel; control.hankel_singular_values": "hankel_singular_values hankelsv",
    "rl.minimal": "minreal minimal_realization",
    "rl.discretise(rl.d2c(G), dt)": "d2d",
    "rl.discretise": "c2d sample_system discretise_controller",
    "rl.simulate": "lsim forced_response initial_response simulate_with_friction",
    "G.step()": "step_response",
    "G.plot()": "bode bodeplot bode_plot pzmap nyquist",
    "rl.frequency_response": "freqresp evalfr",
    "rl.linearise": "linearize",
    "rl.trim": "findop find_operating_point",
    "rl.zeros": "tzero",
    "of python-control, which is installed: control.lqr, lqe, place, care, dare, lyap": (
        "lqr lqi kalman lqe dlqr place acker care icare dare idare lyap dlyap sylvester"
    ),
    "rl.performance_weight, rl.control_weight": "design_weights check_weights noise_weight",
    "rl.export_controller(..., anti_windup=)": "anti_windup",
    "rl.with_delays of a range, rl.cover, or a multiplicative weight in rl.unstructured": "neglected_dynamics",
    "rl.violation_probability(..., probability=).samples_needed": "sample_size",
    "rl.sampled_data_norm": "sampled_robustness sdhinfnorm",
}


def unknown_public_name(name: str, known: Iterable[str]) -> str:
    """Return the sentence on a name that robustlab does not have: its name here, or the nearest one."""
    answers = {old: answer for answer, names in NAMES.items() for old in names.split()}
    if name in answers:
        return f"robustlab has no {name!r}; here it is {answers[name]}"
    return "; ".join(filter(None, [f"robustlab has no {name!r}", did_you_mean(name, (*known, *answers))]))
