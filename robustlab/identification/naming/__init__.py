"""The search over hypotheses.

discovery              `discover`: from records to a verdict
discovery_result       `Discovery`, its parts and its text
greedy_naming          one effect after the other, judged on held-out data, checked backwards; rivals
ranking                one step of it: fits, evidence, bootstrap
residual_after_naming  the force that is left with the named effects in the model, and the lines in it
updated_plant          the plant after naming, and `uncertain_from`: the uncertain model of what remains
"""
