"""Where every design starts and ends: partition, assumptions, scaling; the rebuilt loop and the second voice.

partition            generalised plants: what is disturbance, control, performance, measurement
assumptions          modes that no controller can stabilise, and what the Riccati method would like
scaling              units of order one for time, states and signals
gamma_bounds         lower bounds of gamma for a generalised plant, by points of the right half plane
rebuilt_loop         the controller for the plant as given, and the loop that it closes
stability            proof that a matrix is stable
double_double        matrices with 30 digits
separate_loop        the loop of P(jw) and K(jw), each evaluated on its own, with bounds of the error
independent_check    the second voice: what that says of a norm
performance_measure  what a loop is worth: a norm or mu, estimated and proved
controller           what is kept of a design: K, what it takes, and what was proved of its loop
design               the result of a design, and how its search ended
tuning               numbers that choose speed and accuracy
"""
