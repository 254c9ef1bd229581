"""The search over sets of effects, and what is said of them.

discovery              `discover`: from records to a verdict
search                 sets of effects, by evidence on what is fitted and on what is held out
first_look             which effects are worth a full fit on top of a set
admissible             which sets may be an answer at all
clock                  what inputs do between their samples, and steps that are short enough
posterior              how probable each set is, and which sets make up the answer
answer                 verdict, names, intervals, gaps, and what remains
gaps                   the errors before and after, in windows and in one run
residual_after_naming  the force that is left with the named effects in the model, and the lines in it
updated_plant          the plant after naming, and `uncertain_from`: the uncertain model of what remains
discovery_parts        what a discovery consists of
discovery_result       `Discovery` and its text
progress               where a search stands, every few seconds
"""
