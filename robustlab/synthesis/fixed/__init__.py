"""Controllers of fixed structure or order, for one plant, several, or an uncertain set.

fixed_result      the design with its parameters, and what was verified for every model
structure_starts  starts from the best static gain and from the full-order design
fixed_structure   fixed_structure: search, verification, scenarios of an uncertain set
tuning            numbers that choose speed and accuracy
"""
