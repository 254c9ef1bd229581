"""The table of drawings; nothing is imported here.

`DRAWINGS`: class -> name of a drawing -> ``module.function`` in this package; the first one is the default. The first
paragraph of the function's docstring is the caption in a report.
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
_DISK = {"disk": "robustness_figures.disk_figure"}
_MARGIN = {"mu": "robustness_figures.mu_figure", "shares": "robustness_figures.margin_shares"}

DRAWINGS: Mapping[str, Mapping[str, str]] = {
    # models
    "StateSpaceModel": _MODEL,
    "UncertainModel": _MODEL,
    "DelayedModel": {kind: name for kind, name in _MODEL.items() if kind != "pzmap"},
    "UncertainFrequencyData": {"bode": "model_figures.measured_response_figure"},
    "Controller": _MODEL,
    "GeneralizedPlant": _MODEL,
    "Samples": _MODEL,
    "Record": {"signals": "model_figures.record_figure"},
    "FrequencyData": {"bode": "model_figures.measured_response_figure"},
    "ReducedModel": {"sigma": "model_figures.reduction_figure"},
    # robustness
    **dict.fromkeys(("Margin", "PerformanceMargin"), _MARGIN),
    "WorstCaseGain": {"gain": "robustness_figures.gain_figure"},
    "CriticalResponse": {"replay": "robustness_figures.replay_figure"},
    "MarginAt": {"margin": "robustness_figures.bounds_at"},
    "GainAt": {"gain": "robustness_figures.bounds_at"},
    "DiskMarginAt": {"margin": "robustness_figures.bounds_at"},
    **dict.fromkeys(("DiskBounds", "DiskMargins"), _DISK),
    "Cover": {"set": "set_figures.cover_figure"},
    "Overbound": {"weight": "set_figures.overbound_figure"},
    # members
    "Responses": {"step": "set_figures.band_figure"},
    "WorstCase": {"delta": "set_figures.member_figure", "response": "robustness_figures.worst_case_figure"},
    "ViolationProbability": {
        "distribution": "robustness_figures.distribution_figure",
        "influence": "robustness_figures.violation_influence",
    },
    "CampaignResult": {"delta": "set_figures.member_figure"},
    # designs
    **dict.fromkeys(("Synthesis", "HinfSynthesis", "H2Synthesis", "NcfSynthesis"), _LOOP),
    **dict.fromkeys(("FixedSynthesis", "TunedSynthesis", "ReducedController", "DKSynthesis"), _LOOP),
    "PerformanceComparison": {"mu": "design_figures.performance_picture"},
    "ControlledRuns": {"runs": "design_figures.runs_picture"},
    "TrackingLoop": {"functions": "design_figures.tracking_picture"},
    "SampledController": {"loop": "design_figures.loop_picture"},
    "LoopFunctions": {"functions": "design_figures.gangs_picture"},
    # measurements
    "Comparison": {name: f"comparison_figures.{name}_figure" for name in ("where", "time", "speed")},
    "Discovery": {
        "gap": "discovery.gap_figure",
        "force": "discovery.force_of",
        "run": "discovery.free_run_figure",
    },
    "Validation": {"record": "set_figures.validation_figure"},
    "DataCover": {"record": "set_figures.cover_record"},
    "EnvelopeCoverage": {"envelope": "set_figures.envelope_figure"},
}

# Class -> attribute with its outputs (names, or pairs that begin with one), each of which is drawn.
OUTPUTS: Mapping[str, str] = {
    **dict.fromkeys(("Comparison", "Validation", "Responses"), "outputs"),
    "Discovery": "gaps",
    "EnvelopeCoverage": "signals",
}
