"""Digital controllers: formulas, the sampled loop's exact norm, between the samples too.

discretisation       formulas: Tustin, holds, impulse, matched; pathological sampling
lifting              a plant behind sampler and hold over whole periods, by means over intervals
sampled_norm         the norm of the sampled loop, as a proved bracket
sampled_controller   formulas judged by that norm, and direct design on the lifted plant
tuning               numbers that choose speed and accuracy
"""
