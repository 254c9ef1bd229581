"""What other programs' names, and earlier ones of ours, are called here: ``rl.wcgain`` is ``rl.peak_gain``."""

from __future__ import annotations

from collections.abc import Iterable

from robustlab.errors import did_you_mean

# Answer -> names that it answers; what the pages docs/coming-from say, which a test holds to these tables.
MATLAB = {
    "rl.RealScalar, ranges in rl.parametric, (value, tolerance) in rl.plant": "ureal",
    "rl.ComplexScalar": "ucomplex",
    "rl.FullBlock": "ucomplexm",
    "rl.FullBlock, rl.unstructured": "ultidyn",
    "not there; rl.disk_margin answers the question, of an uncertain plant too": "umargin",
    "not there": "udyn genss thiran hinffi hinffc modreal slowfast",
    "rl.UncertainModel": "uss umat",
    "rl.frequency_data(...), rl.robust_stability": "ufrd",
    "rl.sample(set, n, seed).models()": "usample",
    'set.evaluate({"k": 1.0})': "usubs",
    "set.physical(delta)": "normalized2actual",
    "not there; set.physical(delta) is the other way": "actual2normalized",
    "not there; give other ranges": "uscale",
    "set.M, set.blocks": "lftdata",
    "set.reduce(), rl.reduce_model": "simplify",
    "rl.star": "lft",
    'rl.connect(..., sums=["e = r - y"])': "sumblk iconnect sysic",
    "rl.beside, rl.stacked": "append",
    "G2 @ G1": "series",
    "G1 + G2": "parallel",
    "G.feedback(H)": "feedback",
    'rl.sample(set, n, vertices="all")': "gridureal",
    "rl.cover, of data rl.overbound for the weight": "ucover",
    "rl.with_delays, rl.delay": "InputDelay OutputDelay",
    "rl.delay(tau).pade(n)": "pade",
    "rl.with_delays of a discrete model": "absorbDelay",
    "rl.robust_stability": "robstab robuststab",
    "rl.robust_gain(set, level)": "robgain",
    "rl.robust_performance": "robustperf",
    "rl.peak_gain": "wcgain hinfnorm",
    "rl.peak_gain(set, omega=...)": "wcsigma",
    "not there; close the loop, then rl.peak_gain": "wcsens",
    "not there; rl.mu of the matrix, with fixed=": "wcnorm",
    "rl.disk_margin": "diskmargin loopmargin wcdiskmargin wcmargin",
    "rl.classical_margins": "allmargin margin",
    "rl.zeros": "tzero",
    "rl.mu": "mussv",
    "fields D, G, delta of the result": "mussvextract",
    "rl.nu_gap": "gapmetric gap",
    "rl.coprime_margin": "ncfmargin",
    "rl.peak_gain, rl.h2_norm": "norm",
    'rl.peak_gain(G, norm="linf")': "getPeakGain",
    "rl.passivity": "isPassive getPassiveIndex",
    "rl.loop_functions": "loopsens",
    "rl.robust_stability(set, natures=...), rl.peak_gain(G, natures=...)": "popov quadstab pdlstab quadperf",
    "not there; branch and bound handles purely real problems": "complexify",
    "rl.hinf": "hinfsyn",
    "rl.h2": "h2syn lqg",
    "rl.hinf of an rl.LPVModel, rl.lpv_model": "hinfgs psys aff2pol",
    "rl.h2_hinf": "h2hinfsyn",
    "not there; rl.mixsyn builds it; rl.generalized_plant names the channels of a plant of your own": "augw",
    "rl.ncf": "ncfsyn",
    "not there; rl.ncf with shaping weights comes nearest": "loopsyn",
    "not there; rl.h2 gives LQG without the recovery": "ltrsyn",
    "rl.dk": "musyn dksyn",
    "arguments of rl.dk": "dkitopt",
    "rl.fixed_structure": "hinfstruct",
    "rl.tune": "systune TuningGoal",
    "rl.discretise of a design": "sdhinfsyn",
    "rl.sampled_data_norm": "sdhinfnorm",
    "not there; cvxpy": "lmireg msfsyn feasp mincx",
    "rl.reduce_model": "reduce balancmr balred",
    'rl.reduce_model(..., method="coprime")': "ncfmr",
    'rl.reduce_model(..., method="hankel")': "hankelmr",
    'rl.reduce_model(..., method="stochastic")': "bstmr",
    "not there; the same models as balancmr: rl.reduce_model": "schurmr",
    "rl.hankel_singular_values": "hankelsv",
    "rl.overbound": "fitmagfrd",
    "rl.discretise": "c2d",
    "rl.simulate": "lsim initial",
    'G.step(), G.plot("step")': "step",
    'not there; G.step() is the record, rl.worst_case(set, "overshoot") the worst of a set': "stepinfo",
    "not there; rl.simulate with x0= the input's column of B": "impulse",
    'G.plot("bode")': "bode bodeplot",
    'G.plot("sigma")': "sigma",
    'G.plot("pzmap")': "pzmap pzplot",
    "not there; rl.disk_margin says how near a loop comes to -1": "nyquist nichols rlocus",
    "rl.frequency_response": "freqresp",
    "G(1j * w)": "evalfr",
    "G.poles()": "pole damp",
    "G.zeros(), rl.zeros": "zero",
    "G.dc_gain()": "dcgain",
    "rl.minimal": "minreal",
    "rl.tf": "tf2ss pid pid2",
    "not there; control.ss2tf of G.to_control()": "ss2tf ss2zp",
    "rl.frequency_data": "frd",
    "G.A, G.B, G.C, G.D": "ssdata",
    "rl.descriptor": "dss",
    "not there; python-control has them, and its gains are taken; rl.h2 is LQG": "lqr lqi place kalman lqe estim",
    "not there; python-control and scipy have them": "icare care idare dare lyap dlyap sylvester",
}
PYTHON_CONTROL = {
    "rl.ss, rl.StateSpaceModel": "StateSpace",
    "rl.frequency_data": "frd FrequencyResponseData",
    "rl.tf": "TransferFunction tf2ss",
    "not there; control.ss2tf of G.to_control()": "ss2tf",
    "G2 @ G1": "series",
    "G1 + G2": "parallel",
    "G.feedback(H)": "feedback",
    "rl.beside": "append",
    "G.poles()": "poles",
    "G.dc_gain()": "dcgain",
    'rl.connect(..., sums=["e = r - y"])': "interconnect summing_junction",
    "rl.delay(tau).pade(n)": "pade",
    "rl.hinf": "hinfsyn",
    "rl.h2": "h2syn",
    'rl.peak_gain(G, norm="linf")': "linfnorm",
    "rl.peak_gain, rl.h2_norm": "system_norm norm",
    "rl.passivity": "ispassive",
    "rl.disk_margin": "disk_margins",
    "rl.classical_margins": "margin stability_margins",
    "rl.controllability": "ctrb",
    "rl.observability": "obsv",
    "rl.controllability, rl.observability": "gram",
    "rl.reduce_model": "balanced_reduction model_reduction",
    "rl.discretise": "sample_system c2d",
    "rl.simulate": "forced_response initial_response input_output_response",
    "G.step()": "step_response",
    'not there; G.step() is the record, rl.worst_case(set, "overshoot") the worst of a set': "step_info",
    "not there; rl.simulate with x0= the input's column of B": "impulse_response",
    "G(1j * w)": "evalfr",
    "rl.minimal": "minreal minimal_realization",
    "rl.linearise": "linearize",
    "rl.trim": "find_operating_point",
    'G.plot("bode")': "bode_plot bode",
    'G.plot("sigma")': "singular_values_plot",
    'G.plot("pzmap")': "pole_zero_plot",
    "not there; rl.disk_margin says how near a loop comes to -1": "nyquist_plot nyquist",
    "not there; use python-control: its gains are taken as matrices": (
        "lqr dlqr place acker lqe dlqe create_estimator_iosystem"
    ),
    "not there; use python-control": (
        "root_locus_map root_locus describing_function_response flatsys optimal lyap dlyap care dare"
    ),
}

# Of python-control, which is always installed.
LQ = "control.{}: robustlab takes its results, a gain K too"
# Names of earlier versions -> what asks the same now.
EARLIER = {
    "delay_gain": "rl.peak_gain(model)",
    "effect_gain": "rl.peak_gain(plant, K)",
    "hinf_norm": "rl.peak_gain(model)",
    "iqc_gain": "rl.peak_gain(G, natures=...)",
    "linf_norm": 'rl.peak_gain(G, norm="linf")',
    "lpv_gain": "rl.peak_gain(model)",
    "worst_case_gain": "rl.peak_gain(set)",
    "worst_case_gain_at": "rl.peak_gain(G, frequency=...)",
    "balanced_truncation": "rl.reduce_model(model, order)",
    "by_cause": "rl.elementwise(nominal, {cause: model})",
    "centred": "set.centred(level)",
    "delay_hinf": "rl.hinf(P, n_meas, n_con)",
    "discretise_controller": "rl.discretise(design, dt), or rl.discretise(K, dt, plant=P)",
    "effect_names": "robustlab.dynamics.effects.catalogue.effect_names()",
    "loop_functions_of": "rl.loop_functions(design)",
    "lpv_hinf": "rl.hinf(P, n_meas, n_con)",
    "neglected_delay": "rl.neglected_dynamics(delay=...)",
    "neglected_lag": "rl.neglected_dynamics(lag=...)",
    "perturbed_model": "set.evaluate(delta)",
    "realise_delta": "set.realised(delta, frequency)",
    "reduction": "rl.reduce_model(set)",
    "response_radius": "rl.frequency_data(response, omega, coherence=..., averages=...)",
    "skew_mu": "rl.mu(M, blocks, fixed=...)",
    "uncertain_delays": "rl.with_delays(G, inputs={name: (shortest, longest)})",
    "verify_delayed_loop": "rl.peak_gain(P.close(K)), rl.robust_stability(P.close(K))",
    "lqr": LQ.format("lqr"),
    "lqi": LQ.format("lqr, with integral_action="),
    "place": LQ.format("place"),
    "kalman": LQ.format("lqe"),
    "lqg": "rl.h2(P, n_meas, n_con)",
    "care": LQ.format("care"),
    "dare": LQ.format("dare"),
    "lyap": LQ.format("lyap"),
    "dlyap": LQ.format("dlyap"),
    "sylvester": "scipy.linalg.solve_sylvester",
    "DataCover": "what rl.data_cover gives",
    "FmuPlant": 'rl.plant("machine.fmu")',
    "LPVController": "robustlab.synthesis.LPVController; rl.hinf of an LPVModel gives one",
    "delay_classical_margins": "rl.classical_margins(plant, K)",
    "delay_disk_margin": "rl.disk_margin(loop)",
    "delay_disk_margins": "rl.disk_margin(plant, K)",
    "delay_stability": "rl.robust_stability(model)",
    "disk_margin_at": "rl.disk_margin(plant, K, frequency=...)",
    "iqc_stability": "rl.robust_stability(model, natures=...)",
    "robust_stability_at": "rl.robust_stability(system, frequency=...)",
    "worst_case_disk_margin": "rl.disk_margin(uncertain, K)",
}
PROGRAMS = {"MATLAB": MATLAB, "python-control": PYTHON_CONTROL}


def unknown_public_name(name: str, known: Iterable[str]) -> str:
    """What is said of a name that robustlab does not have: the answer to another program's, or the nearest one.

    Examples
    --------
    >>> unknown_public_name("wcgain", ["peak_gain"])
    "robustlab has no 'wcgain'; MATLAB's wcgain is rl.peak_gain"
    >>> unknown_public_name("peak_gian", ["peak_gain"])
    "robustlab has no 'peak_gian'; did you mean peak_gain?"
    >>> unknown_public_name("skew_mu", [])
    "robustlab has no 'skew_mu' any more; it is rl.mu(M, blocks, fixed=...)"
    """
    found = f"robustlab has no {name!r}"
    if name in EARLIER:
        return f"{found} any more; it is {EARLIER[name]}"
    if said := _elsewhere(name):
        return f"{found}; {said}"
    names = [other for table in PROGRAMS.values() for text in table.values() for other in text.split()]
    hint = did_you_mean(name, (*known, *names))
    if hint is None:
        return found
    said = _elsewhere(hint.removeprefix("did you mean ").removesuffix("?"))
    return f"{found}; {hint} {said}".rstrip()


def _elsewhere(name: str) -> str:
    """``MATLAB's wcgain is rl.peak_gain(set)``; empty where no program has the name."""
    answers: dict[str, list[str]] = {}
    for program, table in PROGRAMS.items():
        for answer, names in table.items():
            if name in names.split():
                answers.setdefault(answer, []).append(f"{program}'s")
    return "; ".join(f"{' and '.join(whose)} {name} is {answer}" for answer, whose in answers.items())
