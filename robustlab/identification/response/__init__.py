"""A model's response to a record, matched by names and units.

response             `response_of`: model and record matched; simulations of stretches of the record
motion_response      a nonlinear plant about the recorded motion, in windows
windowed_simulation  each window from its own best start, and the residual that it leaves; what an input does to an
                     output, whatever the start and a constant disturbance
"""
