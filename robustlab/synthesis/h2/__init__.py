"""H2; H2 under an H-infinity bound.

h2_synthesis         h2: two Riccati equations on a regularised plant
common_lyapunov      H2 and H-infinity conditions with one Lyapunov matrix, as LMIs
mixed_h2_hinf        h2_hinf: the smallest H2 norm under that bound
tuning               numbers that choose speed and accuracy
"""
