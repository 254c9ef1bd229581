"""Controllers of fixed structure or order, for one plant, several, or an uncertain set.

structure_starts  starts from the best static gain and from the full-order design
fixed_structure   fixed_structure: search, verification, scenarios of an uncertain set; the result
design_goals      tracking, sensitivity, gains, variances, margins, overshoot as norms of weighted loops
goal_tuning       tune: hard goals met, soft ones made small, over several plants; what was reached of each
"""
