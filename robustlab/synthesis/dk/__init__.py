"""Robust performance: D-K iteration, direct minimisation over the scalings, D-G-K.

dynamic_scalings     D(s), G(s), the plant with them at a level, and what they prove at all frequencies at once
scalings_fit         the best D, G at single frequencies, and rational ones fitted to them
riccati_level        the smallest level of given scalings, and its derivative by their parameters
robust_problem       controllers of given scalings, closed and proved; the first controller
structured_problem   the same with controllers of a given structure
direct_minimisation  the level minimised over the scalings themselves, in growing order
dk_design            the result
dk_iteration         the stages, and the proof at the end
"""
