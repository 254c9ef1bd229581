"""How large the gap between model and record is, where it lives, and what the residual still contains.

comparison                  `compare`
along_motion                the same for a nonlinear plant, about the recorded motion
joints                      which joint of it each output and input belongs to
parts                       what linear and nonlinear plants share
comparison_result           `Comparison`, its parts and its text
localisation                over time, speed, position, amplitude, direction and frequency
residual_tests              is the residual white, is it independent of the input
noise_floor                 noise without a model, where a record repeats
gap_scales                  the gap as an addition to the input, and in multiples of the noise
best_linear_approximation   the measured frequency response beside the model's
nonlinearity                even and odd nonlinearity from the harmonics of a periodic excitation
envelope                    `cover`: does an uncertain model reach the record
"""
