"""Controllers whose actuators saturate.

back_calculation    of a digital controller: modes made to decay while its outputs saturate
static_anti_windup  the static gain of least proved L2 gain, and its loop
"""
