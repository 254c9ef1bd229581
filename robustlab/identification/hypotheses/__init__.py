"""One hypothesis about what is missing.

prepared_record       a record cut into windows, with their starts and the force that the nominal model lacks
disturbance_smoother  that force, and the states, from a Kalman smoother
smoother_kernels      its compiled recursions
candidates            which effects a plant and its records allow, and the parameters that every hypothesis refits
effect_fit            the fit of a hypothesis by windowed simulation, its evidence, and its distance to another
normal_equations      one step of a fit, with the start of each window eliminated
noise                 the noise that fits are judged by, and fits of held-out data
unnamed_force         the evidence of a force that no effect describes, over speed, position, time, input, and as a line
random_force          what a force at a joint does to the errors of a fit, and their likelihood under a random one
"""
