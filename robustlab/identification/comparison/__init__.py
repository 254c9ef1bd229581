"""How large the gap between model and record is, where it lives, and what the residual still contains.

comparison                  `compare`
along_motion                the same for a nonlinear plant, about the recorded motion, joint by joint
error_analysis              what linear and nonlinear plants share
comparison_result           `Comparison` and its text
localisation                over time, speed, position, amplitude, direction and frequency; as an addition to the input
residual_tests              is the residual white, is it independent of the input; even and odd nonlinearity
noise_floor                 noise without a model, where a record repeats
best_linear_approximation   the measured frequency response beside the model's
envelope                    `cover`: does an uncertain model reach the record
"""
