r"""Two tanks in cascade: a pump fills the upper one, which runs into the lower one, whose level is measured.

.. math::
    A_1 \dot h_1 = k u - a_1 \sqrt{2 g h_1}, \qquad A_2 \dot h_2 = a_1 \sqrt{2 g h_1} - a_2 \sqrt{2 g h_2}, \qquad
    y = k_s h_2

Values of one column of the quadruple tank. An empty tank stays empty; there it has no linear model (the outflow's slope
is infinite).

References
----------
Johansson, "The quadruple-tank process", IEEE Transactions on Control Systems Technology 8(3), 2000.
"""

import casadi as ca

import robustlab as rl

JOHANSSON = "Johansson 2000 (tanks 3 and 1, pump 1); the tolerance is assumed"


def water_tank(**given):
    """Plant with input u [V] and output level [V]."""
    p = rl.PlantEquations("water-tank")

    def size(name, value, unit, meaning, tolerance=0.05, role="none"):
        return p.parameter(
            name, value, unit, tolerance=tolerance, role=role, meaning=meaning, source=JOHANSSON, sign="positive"
        )

    A1 = size("A_1", 28e-4, "m2", "cross-section of the upper tank", 0.02)
    A2 = size("A_2", 28e-4, "m2", "cross-section of the lower tank", 0.02)
    a1 = size("a_1", 0.071e-4, "m2", "outlet of the upper tank")
    a2 = size("a_2", 0.071e-4, "m2", "outlet of the lower tank")
    k = size("k", 3.33e-6, "m3/(s V)", "flow of the pump per volt", role="input-gain")
    ks = p.parameter("k_s", 50.0, "V/m", meaning="level sensor", source="Johansson 2000")
    g = p.parameter("g", 9.81, "m/s2", meaning="gravity", source="Johansson 2000")

    u = p.input("u", "V")
    h1, h2 = p.state("h_1", "m"), p.state("h_2", "m")

    out_1 = a1 * ca.sqrt(2 * g * ca.fmax(h1, 0))
    out_2 = a2 * ca.sqrt(2 * g * ca.fmax(h2, 0))
    p.rate(h1, (k * u - out_1) / A1)
    p.rate(h2, (out_1 - out_2) / A2)
    p.output("level", ks * h2, "V")
    return p.plant(**given)
