"""Where every design starts and ends: partition, assumptions, scaling; the rebuilt loop and its certificate.

partition            generalised plants: what is disturbance, control, performance, measurement
assumptions          modes that no controller can stabilise, and what the Riccati method would like
scaling              units of order one for time, states and signals
gamma_bounds         lower bounds of gamma for a generalised plant, by points of the right half plane
rebuilt_loop         the controller for the plant as given, and the loop that it closes
certify              what the checker proves of P and K as they are stored
performance_measure  what a loop is worth: a norm or mu, estimated and proved
controller           what is kept of a design: K, what it takes, and what was proved of its loop
design               the result of a design, and how its search ended
"""
