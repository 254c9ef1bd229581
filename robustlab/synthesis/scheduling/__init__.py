"""Gain scheduling: models that depend on measured parameters, their induced gain, controllers scheduled by them.

parameter_varying    LPVModel: models at the points of a grid, multi-linear between them
lpv_sources          LPV models of uncertain sets, and of functions that linearise a plant
lpv_loop             the closed loop of an LPV plant and an LPV controller, as an LPV model
lyapunov_inequality  the dissipation inequality over whole cells: its coefficients, and their check outside a solver
induced_gain         lpv_gain: a proved bound of the induced L2 gain
scheduled_controller LPVController: K over the grid, and what was proved of its loop
scheduled_synthesis  hinf of LPV models: a scheduled controller, its loop verified by lpv_gain
"""
