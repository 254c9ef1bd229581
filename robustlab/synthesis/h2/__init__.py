"""H2; H2 under an H-infinity bound.

h2_synthesis         h2: two Riccati equations on a regularised plant

tuning               numbers that choose speed and accuracy
"""
