"""H2, LQG and state feedback; H2 under an H-infinity bound.

h2_synthesis         h2: two Riccati equations on a regularised plant
state_feedback       lqr, place
kalman_filter        kalman
integral_feedback    lqi
disturbance_models   constant, sinusoidal and shaped disturbances beside the plant, and what cancels them
gaussian_regulator   lqg: the first two together, with such disturbances

tuning               numbers that choose speed and accuracy
"""
