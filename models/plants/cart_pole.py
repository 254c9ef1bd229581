r"""Cart with a pole: a force moves the cart, the pole turns freely about a pivot on it.

.. math::
    (M + m)\, \ddot x + m l \cos\theta\, \ddot\theta = F + m l \sin\theta\, \dot\theta^2 - d \dot x

    m l \cos\theta\, \ddot x + (J + m l^2)\, \ddot\theta = m g l \sin\theta - c\, \dot\theta

The angle is zero upright and grows as the pole leans towards positive x; theta = pi hangs.

Try: ``robustlab data discover models/plants/cart_pole.py:cart_pole run.csv``
"""

import casadi as ca

import robustlab as rl


def cart_pole(**given):
    """Plant with input F [N] and outputs x [m], theta [rad]."""
    p = rl.PlantEquations("cart-pole")
    M = p.parameter("M", 1.0, "kg", tolerance=0.05, role="inertia", meaning="mass of the cart", source="assumed")
    m = p.parameter("m", 0.2, "kg", tolerance=0.05, role="inertia", meaning="mass of the pole", source="assumed")
    J = p.parameter(
        "J", 0.006, "kg m2", tolerance=0.1, role="inertia", meaning="inertia of the pole about its centre of mass",
        source="uniform rod of 0.6 m",
    )  # fmt: skip
    length = p.parameter("l", 0.3, "m", meaning="pivot to the pole's centre of mass", source="assumed", sign="positive")
    d = p.parameter(
        "d", 0.5, "N s/m", tolerance=0.3, role="viscous-friction", meaning="friction of the cart", source="assumed"
    )
    c = p.parameter(
        "c", 0.002, "N m s/rad", tolerance=0.5, role="viscous-friction", meaning="friction of the pivot",
        source="assumed",
    )  # fmt: skip
    g = p.parameter("g", 9.81, "m/s2", meaning="gravity", source="standard value, rounded")

    F = p.input("F", "N")
    x, v = p.joint("x", "v", "m")
    theta, omega = p.joint("theta", "omega", "rad")

    coupling = m * length * ca.cos(theta)
    p.motion(
        [[M + m, coupling], [coupling, J + m * length**2]],
        [F + m * length * ca.sin(theta) * omega**2 - d * v, m * g * length * ca.sin(theta) - c * omega],
    )
    p.output("x", x, "m")
    p.output("theta", theta, "rad")
    return p.plant(**given)
