"""One hypothesis about what is missing.

prepared_record       a record cut into windows, with their starts and the force that the nominal model lacks
disturbance_smoother  that force, and the states, from a Kalman smoother
smoother_kernels      its compiled recursions
candidates            which effects a plant and its records allow, and the parameters that every hypothesis refits
effect_fit            the fit of a hypothesis by windowed simulation, its evidence, and its distance to another
"""
