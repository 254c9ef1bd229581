r"""The machine of the blind tests: one compiled simulator, written for these tests alone.

A voltage-driven motor (or a force-driven axis) with everything that a case may hide. Body 1 carries the sensor, body 2
hangs on it by a shaft:

.. math::
    L \dot i &= u_e - R(\vartheta) i - K_e(\omega) \omega - V_b \tanh(i / i_s) \\
    J_1 \dot\omega &= K_t(\omega) i - b_\pm \omega - T_f - T_s - T_\mathrm{load}(\varphi, \omega, t) \\
    J_2 \dot v &= T_s(\varphi - p, \omega - v), \qquad \dot\varphi = \omega, \quad \dot p = v

Dry friction is one LuGre bristle whose level g depends on speed, position, travel and the torque through the gear,

.. math:: \dot z = \omega - \sigma_0 |\omega| z / g, \qquad T_f = \sigma_0 z + \sigma_1 \dot z,

contacts are of Hunt and Crossley, the winding heats by two thermal masses,
an actuator's lag is advanced exactly and acts with its mean over the step. Steps are classical Runge-Kutta of
fourth order, at most 20 microseconds long and shorter where a contact, a bristle or a brush requires it; the bristle
alone, which may be as stiff as it likes, is advanced by the exact solution of its equation at the stage's speed. Steps
end exactly where the delayed input jumps and where the delayed sensor samples, so that delays are exact.

References
----------
Canudas de Wit, Olsson, Astrom, Lischinsky 1995 (LuGre); Hunt and Crossley 1975; Wen 1976 (hysteretic spring).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

LONGEST_STEP = 20e-6


class Machine(NamedTuple):
    """All constants of a machine in SI units (rad or m, N m or N); what is not there is zero."""

    J1: float
    winding: float = 1.0  # 1: voltage-driven motor; 0: force = gain * voltage
    R: float = 0.0
    L: float = 1.0
    Kt: float = 0.0
    Ke: float = 0.0
    weakening: float = 0.0  # speed at which field weakening halves Kt and Ke
    gain: float = 0.0
    Vb: float = 0.0  # brush drop and the current over which it builds up
    i_s: float = 1.0
    alpha: float = 0.0  # temperature coefficient; two thermal masses, winding and housing
    C_w: float = 1.0
    G_wh: float = 0.0
    C_h: float = 1.0
    G_ha: float = 0.0
    b_pos: float = 0.0  # viscous friction by direction
    b_neg: float = 0.0
    s0: float = 1.0  # LuGre
    s1: float = 0.0
    Fc: float = 0.0
    dF: float = 0.0
    vs: float = 1.0
    P: float = 0.0  # position-dependent share P cos(phi / N + a)
    N: float = 1.0
    a_P: float = 0.0
    dFc: float = 0.0  # Fc + dFc forwards, Fc - dFc backwards
    wear: float = 0.0  # growth of Fc per travelled distance
    T0: float = 0.0  # loads on body 1
    drag: float = 0.0
    root_drag: float = 0.0
    root_w: float = 1.0  # speed below which the root is smoothed
    brake: float = 0.0  # brake that bites above a speed
    bite: float = 0.0
    A: float = 0.0  # cogging A cos(n phi + a)
    n: float = 0.0
    a_A: float = 0.0
    k: float = 0.0  # springs to ground
    k3: float = 0.0
    magnet: float = 0.0  # attraction around one place
    x_m: float = 0.0
    w_m: float = 1.0
    grav: float = 0.0  # pendulum grav sin(phi - x_grav)
    x_grav: float = 0.0
    rip: float = 0.0  # ripple over time rip sin(rip_w t + rip_a)
    rip_w: float = 0.0
    rip_a: float = 0.0
    k_h: float = 0.0  # hysteretic spring to ground: stiffness, yield, constant of Bouc and Wen (exponent 1)
    x_h: float = 1.0
    gamma_h: float = 0.0
    side: float = 0.0  # one-sided spring: side (+1, -1, 0 none), place, stiffness
    x_side: float = 0.0
    k_side: float = 0.0
    x_low: float = -math.inf  # end stops: places, stiffness, Hunt-Crossley damping
    x_high: float = math.inf
    k_stop: float = 0.0
    c_stop: float = 0.0
    J2: float = 0.0  # shaft to body 2
    k_s: float = 0.0
    c_s: float = 0.0
    k3_s: float = 0.0
    cq_s: float = 0.0
    gap: float = 0.0
    hc: float = 0.0  # Hunt-Crossley damping of the teeth (used where gap > 0)
    loss: float = 0.0  # 1 / efficiency - 1 of the gear between the bodies
    loss_back: float = -1.0  # the same where the load drives the motor; negative: as `loss`
    delay: float = 0.0  # driver
    lag: float = 0.0  # its time constant
    dead: float = 0.0
    amplify: float = 1.0
    limit: float = math.inf
    slew: float = math.inf
    y_gain: float = 1.0  # angle sensor
    y_bias: float = 0.0
    y_e: float = 0.0  # eccentricity y_e cos(y_n angle + y_a)
    y_n: float = 1.0
    y_a: float = 0.0
    y_delay: float = 0.0
    y_abs: float = 0.0  # 1: the sensor shows the magnitude
    i_bias: float = 0.0


@dataclass(frozen=True)
class Run:
    """Results of one run, each of shape (n,): the logged input, the sensors' readings, the true values."""

    u: Array
    y: Array
    i: Array
    phi: Array
    omega: Array
    current: Array
    load_phi: Array
    load_omega: Array
    temperature: Array


def longest_step(m: Machine) -> float:
    """Step in s that resolves the fastest of contact, shaft, bristle and brush."""
    rates = [1.0]
    if m.Vb:
        rates.append(m.Vb / m.i_s / m.L / 6.0)  # well damped: enough that h rate <= 1.2, RK4 is stable up to 2.78
    if m.k_s:
        rates.append(math.sqrt(m.k_s * (1 / m.J1 + 1 / m.J2)))
    if m.k_stop:
        rates.append(math.sqrt(m.k_stop / m.J1))
    if m.k_h:
        rates.append(math.sqrt(m.k_h / m.J1))
    if m.Fc or m.loss or m.wear:
        rates.append(math.sqrt(m.s0 / m.J1))
    return min(LONGEST_STEP, 0.2 / max(rates))


def simulate(
    m: Machine,
    u: Array,
    dt: float,
    *,
    external: Array | None = None,
    alive: Array | None = None,
    angle_noise: Array | None = None,
    current_noise: Array | None = None,
    lsb: float = 0.0,
    feedback: tuple[float, float, float] | None = None,
    step: float | None = None,
) -> Run:
    """Run the machine from rest at zero: voltage u (n,) held over each sample, or the reference of the angle.

    ``external``: torque on body 1; ``alive``: 1 where the driver works, 0 where it drops out; noise is added to the
    readings, and the angle is rounded to ``lsb`` after that. ``feedback``: (kp, kd, limit) of a sampled position
    controller that reads the sensor and whose output is logged as u.
    """
    n = len(u)
    zeros = np.zeros(n)
    kp, kd, limit = feedback or (0.0, 0.0, 0.0)
    given = (zeros if x is None else x for x in (angle_noise, current_noise))
    constants = Machine(*map(float, m))  # an integer among them would be compiled for once more
    h = longest_step(m) if step is None else step
    around = zeros if external is None else external, np.ones(n) if alive is None else alive, *given
    u = np.ascontiguousarray(u, dtype=np.float64)
    return Run(*_run(constants, u, dt, h, *around, lsb, feedback is not None, kp, kd, limit))


@njit(cache=True, error_model="numpy")
def _shaft(m, e, de):
    """Torque that body 1 passes to body 2 at the twist e and its rate."""
    if m.gap > 0.0:
        if e > 0.5 * m.gap:
            depth = e - 0.5 * m.gap
            return max(0.0, m.k_s * depth * (1.0 + m.hc * de))
        if e < -0.5 * m.gap:
            depth = -e - 0.5 * m.gap
            return -max(0.0, m.k_s * depth * (1.0 - m.hc * de))
        return 0.0
    return m.k_s * e + m.k3_s * e**3 + m.c_s * de + m.cq_s * de * abs(de)


@njit(cache=True, error_model="numpy")
def _friction_level(m, phi, om, travel, shaft):
    loss = m.loss_back if m.loss_back >= 0.0 and shaft * om < 0.0 else m.loss
    level = m.Fc + m.wear * travel + loss * abs(shaft)
    if m.dFc != 0.0:
        level += m.dFc if om >= 0.0 else -m.dFc
    if m.dF > 0.0:
        level += m.dF * math.exp(-((om / m.vs) ** 2))
    if m.P != 0.0:
        level = max(0.0, level + m.P * math.cos(phi / m.N + m.a_P))
    return level


@njit(cache=True, error_model="numpy")
def _bristle(m, level, om, z, tau):
    """Bristle after tau at the constant speed om and friction level: exact."""
    if level <= 0.0:
        return 0.0
    rate = m.s0 * abs(om) / level
    if rate == 0.0:
        return z
    end = math.copysign(level / m.s0, om)
    return end + (z - end) * math.exp(-rate * tau)


@njit(cache=True, error_model="numpy")
def _loads(m, phi, om, x):
    """Torque that holds body 1 back, apart from dry friction and the shaft."""
    load = m.T0 + (m.b_pos if om >= 0.0 else m.b_neg) * om
    if m.drag != 0.0:
        load += m.drag * om * abs(om)
    if m.root_drag != 0.0:
        load += m.root_drag * math.sqrt(abs(om)) * math.tanh(om / m.root_w)
    if m.brake != 0.0 and abs(om) > m.bite:
        load += m.brake * (om - math.copysign(m.bite, om))
    if m.A != 0.0:
        load += m.A * math.cos(m.n * phi + m.a_A)
    if m.k != 0.0 or m.k3 != 0.0:
        load += m.k * phi + m.k3 * phi**3
    if m.magnet != 0.0:
        r = (phi - m.x_m) / m.w_m
        load += m.magnet * r * math.exp(-r * r) * (1.0 + math.tanh(2.0 * r))
    if m.grav != 0.0:
        load += m.grav * math.sin(phi - m.x_grav)
    if m.side != 0.0:
        load += m.side * m.k_side * max(0.0, m.side * (phi - m.x_side))
    if m.k_h != 0.0:
        load += m.k_h * x
    if phi > m.x_high:
        load += _stop(m, phi - m.x_high, om)
    elif phi < m.x_low:
        load -= _stop(m, m.x_low - phi, -om)
    return load


@njit(cache=True, error_model="numpy")
def _stop(m, depth, into):
    """Force of a stop at a depth, entered at the speed ``into``; it pushes only."""
    return max(0.0, m.k_stop * depth * (1.0 + m.c_stop * into))


@njit(cache=True, error_model="numpy")
def _rates(m, u, R, external, travel, z0, tau, phi, om, p, v, i, x):
    """Accelerations of both bodies, rate of current, rate of the hysteretic spring; tau since the step's start."""
    field = 1.0
    if m.weakening > 0.0:
        field = 1.0 / (1.0 + (om / m.weakening) ** 2)
    if m.winding > 0.0:
        drop = 0.0
        if m.Vb > 0.0:
            drop = m.Vb * math.tanh(i / m.i_s)
        di = (u - R * i - m.Ke * field * om - drop) / m.L
        torque = m.Kt * field * i
    else:
        di = 0.0
        torque = m.gain * u
    shaft, dv = 0.0, 0.0
    if m.J2 > 0.0:
        shaft = _shaft(m, phi - p, om - v)
        dv = shaft / m.J2
    dry = 0.0
    level = _friction_level(m, phi, om, travel, shaft)
    if level > 0.0:
        z = _bristle(m, level, om, z0, tau)
        dry = m.s0 * z + m.s1 * (om - m.s0 * abs(om) * z / level)
    dx = 0.0
    if m.k_h != 0.0:
        r = x / m.x_h
        dx = om * (1.0 - m.gamma_h * abs(r)) - (1.0 - m.gamma_h) * abs(om) * r
    dom = (torque + external - _loads(m, phi, om, x) - dry - shaft) / m.J1
    return dom, dv, di, dx


@njit(cache=True, error_model="numpy")
def _run(m, u_in, dt, h_max, external, alive, angle_noise, current_noise, lsb, closed, kp, kd, limit):
    n = len(u_in)
    u = u_in.copy()
    y, seen_i = np.zeros(n), np.zeros(n)
    o_phi, o_om, o_i, o_p, o_v, o_temp = (np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n))
    sampled = np.zeros(n)  # the angle at the sensor's own instant in each interval
    phi = om = p = v = i = z = x = travel = warm_w = warm_h = drive = lagged = 0.0
    late = math.floor(m.delay / dt + 1e-9)
    cut_u = max(0.0, m.delay - late * dt)
    if cut_u < 1e-9 * dt:
        cut_u = 0.0
    late_y = math.ceil(m.y_delay / dt - 1e-9)  # whole samples back, from where cut_y goes forward
    cut_y = max(0.0, late_y * dt - m.y_delay)
    if cut_y < 1e-9 * dt:
        cut_y = 0.0
    before = 0.0
    slope = 0.0
    for k in range(n):
        if cut_y == 0.0:
            sampled[k] = phi
        o_phi[k], o_om[k], o_i[k], o_p[k], o_v[k], o_temp[k] = phi, om, i, p, v, warm_w
        angle = sampled[k - late_y] if k >= late_y else 0.0
        reading = m.y_gain * angle + m.y_bias
        if m.y_e != 0.0:
            reading += m.y_e * math.cos(m.y_n * angle + m.y_a)
        if m.y_abs > 0.0:
            reading = abs(reading)
        reading += angle_noise[k]
        if lsb > 0.0:
            reading = math.floor(reading / lsb + 0.5) * lsb
        y[k] = reading
        seen_i[k] = i + m.i_bias + current_noise[k]
        if closed:
            slope += 0.3 * ((reading - before) / dt - slope)
            before = reading
            u[k] = min(limit, max(-limit, kp * (u_in[k] - reading) - kd * slope))
        at = 0.0
        while at < dt:
            new = u[k - late] if k >= late else 0.0
            old = u[k - late - 1] if k >= late + 1 else 0.0
            requested = old if at < cut_u else new
            end = dt
            if at < cut_u < end:
                end = cut_u
            if at < cut_y < end:
                end = cut_y
            steps = math.ceil((end - at) / h_max - 1e-9)
            h = (end - at) / steps
            for step in range(steps):
                if requested > drive:
                    drive = min(requested, drive + m.slew * h)
                else:
                    drive = max(requested, drive - m.slew * h)
                acting = drive
                if m.lag > 0.0:
                    left = -math.expm1(-h / m.lag)
                    acting = drive + (lagged - drive) * left * m.lag / h
                    lagged += (drive - lagged) * left
                ue = acting * m.amplify
                ue = max(0.0, abs(ue) - m.dead) * (1.0 if ue >= 0.0 else -1.0)
                ue = min(m.limit, max(-m.limit, ue)) * alive[k]
                R = m.R * (1.0 + m.alpha * warm_w)
                t1 = t2 = t4 = external[k]
                if m.rip != 0.0:
                    now = k * dt + at + step * h
                    t1 += m.rip * math.sin(m.rip_w * now + m.rip_a)
                    t2 += m.rip * math.sin(m.rip_w * (now + 0.5 * h) + m.rip_a)
                    t4 += m.rip * math.sin(m.rip_w * (now + h) + m.rip_a)
                om0, i0 = om, i
                a1, b1, c1, d1 = _rates(m, ue, R, t1, travel, z, 0.0, phi, om, p, v, i, x)
                q = 0.5 * h
                a2, b2, c2, d2 = _rates(
                    m, ue, R, t2, travel, z, q, phi + q * om, om + q * a1, p + q * v, v + q * b1, i + q * c1, x + q * d1
                )
                om2, v2 = om + q * a1, v + q * b1
                om3, v3 = om + q * a2, v + q * b2
                a3, b3, c3, d3 = _rates(m, ue, R, t2, travel, z, q, phi + q * om2, om3, p + q * v2, v3, i + q * c2,
                                        x + q * d2)  # fmt: skip
                om4, v4 = om + h * a3, v + h * b3
                a4, b4, c4, d4 = _rates(m, ue, R, t4, travel, z, h, phi + h * om3, om4, p + h * v3, v4, i + h * c3,
                                        x + h * d3)  # fmt: skip
                moved = h * (om + 2.0 * om2 + 2.0 * om3 + om4) / 6.0
                phi += moved
                p += h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
                om += h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
                v += h * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0
                i += h * (c1 + 2.0 * c2 + 2.0 * c3 + c4) / 6.0
                x += h * (d1 + 2.0 * d2 + 2.0 * d3 + d4) / 6.0
                shaft = _shaft(m, phi - p, om - v) if m.J2 > 0.0 else 0.0
                z = _bristle(m, _friction_level(m, phi, om, travel, shaft), 0.5 * (om0 + om), z, h)
                travel += abs(moved)
                if m.alpha > 0.0:
                    flow = m.G_wh * (warm_w - warm_h)
                    warm_w += h * (0.5 * (i0 * i0 + i * i) * R - flow) / m.C_w
                    warm_h += h * (flow - m.G_ha * warm_h) / m.C_h
            at = end
            if at == cut_y:
                sampled[k] = phi
    return u, y, seen_i, o_phi, o_om, o_i, o_p, o_v, o_temp
