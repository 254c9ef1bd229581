"""Models and controllers of lower order, with certified errors.

balancing             Gramian factors, balanced states, truncation and residualisation
model_reduction       models, by a tolerance or an order; weights; coprime factors
controller_reduction  controllers, by what the loop loses
"""
