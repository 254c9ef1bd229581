"""Which drawings every class has, and what a report writes below them; nothing is imported here.

`DRAWINGS`: class -> name of a drawing -> function that makes the figure, ``module.function`` in this room; the first
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
_DISK = {"disk": "result_figures.disk_figure"}

DRAWINGS: Mapping[str, Mapping[str, str]] = {
    # models
    "StateSpaceModel": _MODEL,
    "UncertainModel": _MODEL,
    "DelayedModel": {kind: name for kind, name in _MODEL.items() if kind != "pzmap"},
    "UncertainFrequencyData": {"bode": "result_figures.measured_response_figure"},
    "Controller": _MODEL,
    "GeneralizedPlant": _MODEL,
    "Samples": _MODEL,
    "EffectBlocks": {"blocks": "set_figures.blocks_of"},
    "Record": {"signals": "result_figures.record_figure"},
    "FrequencyData": {"bode": "result_figures.measured_response_figure"},
    "ReducedModel": {"sigma": "result_figures.reduction_figure", "hankel": "result_figures.hankel_figure"},
    "StructuralTest": {"modes": "result_figures.mode_figure"},
    # robustness
    "Margin": {"mu": "robustness_figures.mu_figure", "shares": "robustness_figures.margin_shares"},
    "WorstCaseGain": {"gain": "robustness_figures.gain_figure"},
    "MarginAt": {"margin": "robustness_figures.bounds_at"},
    "GainAt": {"gain": "robustness_figures.bounds_at"},
    "DiskMarginAt": {"margin": "robustness_figures.bounds_at"},
    "DiskMarginsAt": {"margin": "robustness_figures.bounds_at", **_DISK},
    "MuBounds": {"mu": "result_figures.mu_bars"},
    "SmallGain": {"gain": "result_figures.small_gain_figure"},
    "DiskBounds": _DISK,
    "SampledRobustness": {"mu": "robustness_figures.sampled_figure"},
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
    "Synthesis": _LOOP,
    "DKSynthesis": {**_LOOP, "mu": "design_figures.mu_picture", "history": "design_figures.history_picture"},
    "TrackingLoop": {"functions": "design_figures.tracking_picture"},
    "SampledController": {"loop": "design_figures.loop_picture"},
    "LoopFunctions": {"functions": "design_figures.gangs_picture"},
    "StateFeedback": {"pzmap": "result_figures.feedback_figure"},
    "KalmanFilter": {"pzmap": "result_figures.estimator_figure"},
    "IntegralFeedback": {"pzmap": "result_figures.estimator_figure"},
    "DesignWeights": {"weights": "result_figures.weights_figure"},
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

CAPTIONS: Mapping[str, str] = {
    "robustness_figures.mu_figure": "Bounds of μ over frequency. The proved margin is the inverse of the highest "
    "shaded level.",
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
    "design_figures.history_picture": "The search: what each iterate proves of μ, and its order.",
}
