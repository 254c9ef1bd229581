r"""Height of a quadrotor that hovers level: four rotors follow their commanded speed with a lag.

.. math::
    m\, \dot v = 4 k_t \Omega^2 - d\, v - m g, \qquad T\, \dot\Omega = u - \Omega, \qquad \dot z = v
"""

import robustlab as rl


def quadrotor_height(**given):
    """Plant with input u [rad/s], the commanded speed of all rotors, and output z [m], the height."""
    p = rl.PlantEquations("quadrotor-height")
    m = p.parameter("m", 0.5, "kg", tolerance=0.05, role="inertia", meaning="mass", source="assumed")
    kt = p.parameter(
        "k_t", 3e-6, "N s2/rad2", tolerance=0.1, role="input-gain", meaning="thrust of a rotor per square of its speed",
        source="assumed", sign="positive",
    )  # fmt: skip
    T = p.parameter(
        "T", 0.05, "s", tolerance=0.2, role="none", meaning="lag of the rotors", source="assumed", sign="positive"
    )
    d = p.parameter(
        "d", 0.1, "N s/m", tolerance=0.5, role="viscous-friction", meaning="drag of the air, linear", source="assumed"
    )
    g = p.parameter("g", 9.81, "m/s2", meaning="gravity", source="standard value, rounded")

    u = p.input("u", "rad/s")
    z, v = p.joint("z", "v", "m")
    rotor = p.state("rotor", "rad/s")

    p.rate(v, (4 * kt * rotor**2 - d * v - m * g + p.force(v)) / m)
    p.rate(rotor, (u - rotor) / T)
    p.output("z", z, "m")
    return p.plant(**given)
