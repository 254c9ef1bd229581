"""What no effect of the catalogue explains: a residual force over its coordinates.

unnamed_effect    curves over each coordinate, whether anything systematic is left, an additive map of it
block_regression  the regression behind them, judged by blocks of time
"""
