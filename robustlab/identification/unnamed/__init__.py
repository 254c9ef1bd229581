"""What no effect of the catalogue explains: a residual force over its coordinates.

unnamed_effect    curves over each coordinate
block_regression  the regression behind them, judged by blocks of time
"""
