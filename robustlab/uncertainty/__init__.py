"""Uncertain models: sets ``F_u(M, Delta)`` over structured perturbations Delta.

blocks/         the kinds of uncertainty behind one contract; Delta from their values and back
lft             UncertainModel: members, frequency responses, operators
algebra         star product, concatenation, centred ranges, reduction with its evidence
elementwise     real parameters from a nominal and a perturbed model (Březina 2010)
parametric      real parameters in rational expressions: laurent, decomposition_tree
unstructured    one full block between two weights, in six places of the loop
realised_delta  a complex Delta as a stable system
frequency_responses
                uncertain frequency-response data: sets of responses at given frequencies
covering/       sets that hold given models: weights above a bound, hulls, directions
distances/      coprime factors, their margin, nu-gap

Beneath them: upper_lft (a constant Delta closed in), reduction (Kalman reduction), interconnection (operands and
wires, weights of unmodelled dynamics).
"""
