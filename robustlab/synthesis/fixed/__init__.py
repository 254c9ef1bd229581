"""Controllers of fixed structure or order, for one plant, several, or an uncertain set.

structure_starts  starts from the best static gain and from the full-order design
fixed_structure   fixed_structure: search, verification, scenarios of an uncertain set; the result
goal_tuning       goals as norms of weighted loops, and tune: hard ones met, soft ones small, several plants
"""
