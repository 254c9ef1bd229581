"""H-infinity: two Riccati equations, the search around them, what stands behind it, and what is made of it.

two_riccati        the gamma test and the central controller of a regular plant
search             trials over regularisations in two scalings; softer controllers
verification       candidates rebuilt on the plant as given, their norm proved
lmi_synthesis      the projection LMIs, where the equations give nothing
hinf_synthesis     hinf: all of these in order, and nonsmooth search behind them
mixed_sensitivity  mixsyn: S, K S and T shaped by weights
loop_shaping       ncf: the most robust controller of a shaped plant
two_degree         ncf with a reference model: two degrees of freedom
"""
