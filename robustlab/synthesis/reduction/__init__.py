"""Models and controllers of lower order, with certified errors.

balancing             Gramian factors, balanced states, truncation and residualisation
band_gramians         Gramian factors over a band of frequencies
split_error           what splitting off modes cost, bounded over the axis
hankel_norm           the nearest model in the Hankel norm
relative_error        stochastic balancing: errors relative to the gain
coprime_reduction     through normalised coprime factors
reduced_model         the result
model_reduction       models, by a tolerance or an order; weights, a band
controller_reduction  controllers, by what the loop loses
"""
