"""H-infinity: two Riccati equations, the search around them, and what is made of it.

two_riccati        the gamma test and the central controller of a regular plant
search             trials over regularisations in two scalings; softer controllers
verification       candidates rebuilt on the plant as given, their norm proved
lmi_synthesis      the projection LMIs of scheduled plants
hinf_synthesis     hinf: the search on two scalings, verified
mixed_sensitivity  mixsyn: S, K S and T shaped by weights
loop_shaping       ncf: the most robust controller of a shaped plant
"""
