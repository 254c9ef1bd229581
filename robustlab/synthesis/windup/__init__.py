"""Controllers whose actuators saturate.

back_calculation    of a digital controller: modes made to decay while its outputs saturate
"""
