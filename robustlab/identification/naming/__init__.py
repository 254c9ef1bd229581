"""The search over sets of effects, and what is said of them.

discovery              `discover`: from records to a verdict, which sets may be one, and where the search stands
set_search             sets of effects, by evidence on what is fitted and on what is held out
first_look             which effects are worth a full fit on top of a set
posterior              how probable each set is, and which sets make up the answer
answer                 verdict, names, intervals, what remains, and the errors before and after
residual_after_naming  the force that is left with the named effects in the model, and the lines in it
updated_plant          the plant after naming, and `uncertain_from`: the uncertain model of what remains
named_effects          what a discovery consists of: named effects, their values, gaps, sets
discovery_numbers      what of a discovery requirements may refer to
discovery_result       `Discovery` and its text
"""
