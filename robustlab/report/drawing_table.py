"""Which drawings every class has, and what a report writes below them; nothing is imported here.

`DRAWINGS`: class -> name of a drawing -> function that makes the figure, ``module.function`` in this package; the first
one is drawn where none is named. `CAPTIONS`: the same function -> what it shows, in a sentence.
"""

from __future__ import annotations

from collections.abc import Mapping

_MODEL = {
    "bode": "model_figures.bode_figure",
    "step": "model_figures.step_figure",
    "sigma": "model_figures.sigma_figure",
    "pzmap": "model_figures.pole_figure",
}
_LOOP = {"loop": "design_figures.loop_picture", "functions": "design_figures.functions_picture"}
_SAMPLED = {"loop": "design_figures.loop_picture"}
_DISK = {"disk": "result_figures.disk_figure"}
_MARGIN = {"mu": "robustness_figures.mu_figure", "shares": "robustness_figures.margin_shares"}

DRAWINGS: Mapping[str, Mapping[str, str]] = {
    # models
    "StateSpaceModel": _MODEL,
    "UncertainModel": _MODEL,
    "DelayedModel": {kind: name for kind, name in _MODEL.items() if kind != "pzmap"},
    "UncertainFrequencyData": {"bode": "result_figures.measured_response_figure"},
    "Controller": _MODEL,
    "GeneralizedPlant": _MODEL,
    "Samples": _MODEL,
    "EffectBlocks": {"blocks": "set_figures.blocks_figure"},
    "Record": {"signals": "result_figures.record_figure"},
    "FrequencyData": {"bode": "result_figures.measured_response_figure"},
    "ReducedModel": {"sigma": "result_figures.reduction_figure", "hankel": "result_figures.hankel_figure"},
    "StructuralTest": {"modes": "result_figures.mode_figure"},
    # robustness
    **dict.fromkeys(("Margin", "PerformanceMargin"), _MARGIN),
    "WorstCaseGain": {"gain": "robustness_figures.gain_figure"},
    "CriticalResponse": {"replay": "robustness_figures.replay_figure"},
    "MarginAt": {"margin": "robustness_figures.bounds_at"},
    "GainAt": {"gain": "robustness_figures.bounds_at"},
    "DiskMarginAt": {"margin": "robustness_figures.bounds_at"},
    "DiskMarginsAt": {"margin": "robustness_figures.bounds_at", **_DISK},
    "MuBounds": {"mu": "result_figures.mu_bars"},
    **dict.fromkeys(("DiskBounds", "DiskMargins"), _DISK),
    "SampledDataNorm": {"history": "result_figures.norm_history"},
    "Cover": {"set": "set_figures.cover_figure"},
    "Overbound": {"weight": "set_figures.overbound_figure"},
    # members
    "Responses": {"step": "result_figures.band_figure"},
    "WorstCase": {"delta": "result_figures.delta_figure", "response": "robustness_figures.worst_case_figure"},
    "ViolationProbability": {
        "distribution": "robustness_figures.distribution_figure",
        "influence": "robustness_figures.violation_influence",
    },
    "CampaignResult": {"exceedance": "result_figures.campaign_figure", "delta": "result_figures.delta_figure"},
    # designs
    **dict.fromkeys(("Synthesis", "HinfSynthesis", "H2Synthesis", "NcfSynthesis"), _LOOP),
    **dict.fromkeys(("FixedSynthesis", "TunedSynthesis", "ReducedController"), _LOOP),
    "DKSynthesis": {**_LOOP, "mu": "design_figures.mu_picture", "history": "design_figures.history_picture"},
    "PerformanceComparison": {"mu": "design_figures.performance_picture"},
    "ControlledRuns": {"runs": "design_figures.runs_picture"},
    "TrackingLoop": {"functions": "design_figures.tracking_picture"},
    "SampledController": _SAMPLED,
    "LoopFunctions": {"functions": "design_figures.gangs_picture"},
    # measurements
    "Comparison": {
        name: f"comparison_figures.{name}_figure"
        for name in ("where", "time", "speed", "spectrum", "response", "residual", "outputs", "harmonics")
    },
    "Discovery": {
        "gap": "discovery.gap_figure",
        "force": "discovery.force_of",
        "run": "discovery.free_run_figure",
        "stretch": "discovery.stretch_figure",
        "posterior": "discovery.posterior_figure",
    },
    "Validation": {"record": "set_figures.record_of", "delta": "set_figures.delta_figure"},
    "DataCover": {"record": "set_figures.cover_record"},
}

# Class -> function that makes all its figures by name; where they are of an output, NAME-OUTPUT.
SETS: Mapping[str, str] = {
    "Comparison": "comparison_figures.comparison_figures",
    "Discovery": "discovery.discovery_figures",
    "Validation": "set_figures.validation_figures",
    "EnvelopeCoverage": "set_figures.envelope_figures",
    "Responses": "result_figures.band_figures",
}
# Class -> what a file of such a figure begins with in a folder, where its name is that of a signal alone.
PREFIXES: Mapping[str, str] = dict.fromkeys(("EnvelopeCoverage", "Responses"), "envelope-") | {
    "Validation": "validation-"
}

CAPTIONS: Mapping[str, str] = {
    "robustness_figures.mu_figure": "Bounds of μ over frequency. The proved margin is the inverse of the highest "
    "shaded level.",
    "robustness_figures.replay_figure": "Free responses from the critical mode: nominal, just inside the margin, and "
    "at the critical Δ.",
    "robustness_figures.margin_shares": "What each block weighs in the margin: the one on top is to be tightened "
    "first.",
    "design_figures.loop_picture": "The weighted closed loop with its peak, and the controller.",
    "design_figures.functions_picture": "S, K S, T and S G of the loop, below γ / |W| where there is a weight.",
    "design_figures.tracking_picture": "The nominal loop against its weights.",
    "result_figures.delta_figure": "The worst member found: where each parameter lies in its range.",
    "robustness_figures.worst_case_figure": "The output that is judged: nominal, and of the worst member found.",
    "robustness_figures.distribution_figure": "The metric of the random members, and the limit.",
    "robustness_figures.violation_influence": "Which parameters matter: share of the spread, and the worst sample with "
    "one of them nominal.",
    # of sets: function, the figure's name before the output's; {} is that output
    "comparison_figures.comparison_figures where": "Where {} is missed: rms of the error over time, direction, speed, "
    "position, input, frequency; orange is the largest of each.",
    "comparison_figures.comparison_figures response": "The linear part of the record and of the model: frequency "
    "response from the inputs to {}.",
    "comparison_figures.comparison_figures harmonics": "What a linear model cannot explain: lines of the record's "
    "spectrum beyond the excited ones.",
    "comparison_figures.comparison_figures time": "{}: record and simulation, and the error over time; shaded: the "
    "window with the largest error.",
    "comparison_figures.comparison_figures speed": "Where the error of {} lives over speed: dry friction shows as a "
    "step at zero speed.",
    "comparison_figures.comparison_figures spectrum": "Where the error of {} lives over frequency.",
    "comparison_figures.comparison_figures outputs": "The windowed error of all outputs beside each other.",
    "comparison_figures.comparison_figures residual": "What is left of {}: correlation of the residual with itself and "
    "with the input, and the 99 % band.",
    "discovery.discovery_figures story": "Error on data that the fit never saw: the nominal model, refitted within "
    "its tolerances, and updated. A free run is one over a whole record; of a nonlinear plant it is a linear run, "
    "about the recorded motion.",
    "discovery.discovery_figures run": "{}: one simulation from the start of a held-out record to its end, without "
    "restarts; errors below.",
    "discovery.discovery_figures stretch": "{}: a held-out stretch, window by window: record and models, and their "
    "errors below.",
    "discovery.discovery_figures posterior": "Sets of effects and how probable they are; blue: the smallest collection "
    "with 95 %.",
    "discovery.discovery_figures force": "The force that the refitted and the updated model lack, over each "
    "coordinate, with its 95 % band.",
    "set_figures.validation_figures delta": "How large each block of Delta is at each frequency in the explanation.",
    "set_figures.validation_figures": "{}: the record, the nominal model, and the member that explains it with the "
    "smallest Delta; below, what each of them leaves, in the noise bound.",
    "set_figures.envelope_figures": "{}: the record, and below it the record minus the nominal model, in the envelope "
    "of all members.",
    "result_figures.band_figures": "{}: nominal, members and their envelope.",
    "design_figures.performance_picture": "μ of robust performance; thin lines: proved at all frequencies. "
    "Below 1 every member meets the requirement.",
    "design_figures.runs_picture": "The errors and the controls under each controller, and the limits.",
    "design_figures.history_picture": "The search: what each iterate proves of μ, and its order.",
}
