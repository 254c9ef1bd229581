r"""Planar robot arm with two links in a vertical plane, driven by a torque at each joint.

.. math::
    \begin{bmatrix} a_1 + 2 a_2 \cos q_2 & a_3 + a_2 \cos q_2 \\ a_3 + a_2 \cos q_2 & a_3 + I_{r2} \end{bmatrix} \ddot q
    = \tau - \begin{bmatrix} -a_2 \sin q_2 (2 \dot q_1 \dot q_2 + \dot q_2^2) \\ a_2 \sin q_2\, \dot q_1^2 \end{bmatrix}
    - \begin{bmatrix} b_1 \dot q_1 \\ b_2 \dot q_2 \end{bmatrix} - G(q)

.. math::
    a_1 = I_1 + I_2 + m_1 c_1^2 + m_2 (l_1^2 + c_2^2) + I_{r1}, \quad a_2 = m_2 l_1 c_2, \quad a_3 = I_2 + m_2 c_2^2

Joint 1 turns the first link from the horizontal, joint 2 the second one from the first; both upwards. The rotors turn
with their joints, geared: their inertias are those seen at the joints.
"""

import casadi as ca

import robustlab as rl


def two_link_arm(**given):
    """Plant with inputs torque_1, torque_2 [N m] and outputs q_1, q_2 [rad]."""
    p = rl.PlantEquations("two-link-arm")

    def link(k, mass, centre, inertia, rotor, friction):
        m = p.parameter(
            f"m_{k}", mass, "kg", tolerance=0.03, role="inertia", meaning=f"mass of link {k}", source="assumed"
        )
        c = p.parameter(
            f"c_{k}", centre, "m", meaning=f"joint {k} to the centre of mass of link {k}", source="assumed",
            sign="positive",
        )  # fmt: skip
        i = p.parameter(
            f"I_{k}", inertia, "kg m2", tolerance=0.1, role="inertia",
            meaning=f"inertia of link {k} about its centre of mass", source="slender rod of its length",
        )  # fmt: skip
        r = p.parameter(
            f"I_r{k}", rotor, "kg m2", tolerance=0.1, role="inertia", meaning=f"rotor {k}, seen at its joint",
            source="assumed",
        )  # fmt: skip
        b = p.parameter(
            f"b_{k}", friction, "N m s/rad", tolerance=0.3, role="viscous-friction", meaning=f"friction of joint {k}",
            source="assumed",
        )  # fmt: skip
        return m, c, i, r, b

    m1, c1, I1, Ir1, b1 = link(1, 4.0, 0.2, 0.0533, 0.10, 0.8)
    m2, c2, I2, Ir2, b2 = link(2, 2.5, 0.15, 0.0188, 0.04, 0.3)
    l1 = p.parameter("l_1", 0.4, "m", meaning="joint 1 to joint 2", source="assumed", sign="positive")
    g = p.parameter("g", 9.81, "m/s2", meaning="gravity", source="standard value, rounded")

    t1, t2 = p.input("torque_1", "N m"), p.input("torque_2", "N m")
    q1, w1 = p.joint("q_1", "w_1", "rad")
    q2, w2 = p.joint("q_2", "w_2", "rad")

    a1 = I1 + I2 + m1 * c1**2 + m2 * (l1**2 + c2**2) + Ir1
    a2, a3 = m2 * l1 * c2, I2 + m2 * c2**2
    bend = a2 * ca.sin(q2)
    coupling = a3 + a2 * ca.cos(q2)
    fall_2 = m2 * g * c2 * ca.cos(q1 + q2)
    fall_1 = (m1 * c1 + m2 * l1) * g * ca.cos(q1) + fall_2
    p.motion(
        [[a1 + 2 * a2 * ca.cos(q2), coupling], [coupling, a3 + Ir2]],
        [t1 + bend * (2 * w1 * w2 + w2**2) - b1 * w1 - fall_1, t2 - bend * w1**2 - b2 * w2 - fall_2],
    )
    p.output("q_1", q1, "rad")
    p.output("q_2", q2, "rad")
    return p.plant(**given)
