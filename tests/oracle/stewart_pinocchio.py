"""The Stewart platform as a rigid-body tree in Pinocchio with exactly closed loops: an independent judge.

Nothing here comes from the package under test: the tree is written from the published geometry and body data alone,
and the dynamics are Pinocchio's recursive algorithms, not a Lagrangian. Each leg is

    base - turn about x* through b_i - shift c along y* - turn about x* x y* (lower link with motor body)
                                                              |- turn about K: the rotating nut
                                                              |- slide along K: the ball screw (does not spin)

and the platform is a free flyer: 30 coordinates q. The 24 constraints (six ball joints at the platform, six couplings
nut angle = 2 pi/lead * extension) are met exactly, without soft springs. With the 24 x 30 constraint Jacobian C and
the 6 x 30 selector S of the nuts,

    [C; S] W = [0; 1]                 tree velocities of the unit nut rates, v = W phidot
    [C; S] h = [-Cdot v; 0]           tree accelerations at phidd = 0, vdot = W phidd + h
    M = W' M_tree W + J k^2,          bias = W' (M_tree h + n(q, v)),    k u = M phidd + bias.

Readings where the printed text is open, each judged by the published numbers:

* x*_i points from b_i to the bearing point m_i; y*_i is the part of p_i - b_i normal to it; d_i = b_i + c y*_i.
* Body axes (I, J, K) are those at assembly, the home pose, and ride on the lower link from then on (a universal joint
  lets the link roll about K, so I does not stay horizontal). I_i = (-1)^i K_i x z, made a unit vector: its norm is the
  published 0.7275. The other sign gives a holding torque of 0.87051e-3 instead of 0.87011e-3 N m.
* Inertias are about the centres of gravity, along (I, J, K). The nut's tensor turns with the nut, aligned at home.
* The nut turns by +phi about +K on the lower link (right hand, all six legs); the screw slides without turning.

All lengths in m, masses in kg, inertias in kg m2, torques in N m.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]
ROTOR_INERTIA = 7.2e-6  # Maxon RE 35 (273754)
_DEGREE = np.pi / 180.0


@dataclass(frozen=True)
class Body:
    """One rigid body: mass, principal inertias about its centre of gravity along (I, J, K)."""

    mass: float
    inertia: tuple[float, float, float]

    def scaled(self, factor: float) -> Body:
        """The same shape with another density: mass and inertia times ``factor``."""
        i = self.inertia
        return Body(self.mass * factor, (i[0] * factor, i[1] * factor, i[2] * factor))


def disc(mass: float, radius: float = 0.190, height: float = 0.010) -> Body:
    """Uniform disc with its axis along z."""
    across = mass * (3 * radius**2 + height**2) / 12
    return Body(mass, (across, across, mass * radius**2 / 2))


@dataclass(frozen=True)
class Parameters:
    """The published mechanism; the defaults are the preset ``thesis``."""

    lower_link: Body = Body(0.435, (5.07492e-4, 4.99276e-4, 1.31934e-4))
    nut: Body = Body(0.125, (1.9318e-5, 1.9312e-5, 2.2071e-5))
    ball_screw: Body = Body(0.112, (1.93005e-4, 1.92973e-4, 1.996e-6))
    motor: Body = Body(0.34, (3.73333e-4, 3.73325e-4, 6.4002e-5))
    platform: Body = field(default_factory=lambda: disc(3.167))
    lower_link_cg: float = 0.06309  # along K from the second joint axis
    nut_origin: float = 0.08412
    nut_cg: float = 0.004  # from its origin, up
    screw_cg: float = 0.07414  # from the ball joint, towards the base
    motor_offset: tuple[float, float, float] = (0.03, 0.0, 0.1041)
    motor_cg: float = 0.1087 / 2  # from its origin, + up (as printed), - down
    base_radius: float = 0.17502
    base_angle: float = 10.84
    platform_radius: float = 0.190
    platform_angle: float = 6.47
    bearing_radius: float = 0.17611
    bearing_angle: float = 5.52
    bearing_height: float = 0.0169
    shift: float = 0.010  # c, of the second joint axis towards the platform
    home_height: float = 0.1262
    lead: float = 0.004
    gear: float = 4.8 * 41 / 21
    rotor_inertia: float = 0.0
    gravity: float = 9.81
    platform_cg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in the platform frame
    tilt: tuple[float, float] = (0.0, 0.0)  # of the base: turned about its x axis, then about the level y axis
    offset_sign: float = 1.0  # of I_i = sign (-1)^i (K_i x z) at home; the published torque needs +

    def with_bodies_scaled(self, factor: float) -> Parameters:
        """All bodies scaled in mass and inertia; the rotor is not one of them."""
        names = ("lower_link", "nut", "ball_screw", "motor", "platform")
        return replace(self, **{name: getattr(self, name).scaled(factor) for name in names})


THESIS = Parameters()
PHYSICAL = replace(THESIS, rotor_inertia=ROTOR_INERTIA)


def rotation(angles: Array) -> Array:
    """R = Rz(az) Ry(ay) Rx(ax) of (ax, ay, az)."""
    ax, ay, az = angles
    return pin.utils.rotate("z", az) @ pin.utils.rotate("y", ay) @ pin.utils.rotate("x", ax)


def _ring(radius: float, degrees: Array, height: float = 0.0) -> Array:
    return np.column_stack(
        [radius * np.cos(degrees * _DEGREE), radius * np.sin(degrees * _DEGREE), np.full(len(degrees), height)]
    )


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


class PinocchioStewart:
    """The tree and its exact reduction to the nut coordinates phi_1..6; pose = (tx, ty, tz, ax, ay, az)."""

    def __init__(self, parameters: Parameters = THESIS) -> None:
        self.parameters = par = parameters
        side = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0])  # (-1)^i
        at_base = np.array([330.0, 90.0, 90.0, 210.0, 210.0, 330.0]) - side * par.base_angle
        at_platform = np.array([30.0, 30.0, 150.0, 150.0, 270.0, 270.0]) + side * par.platform_angle
        self.base_points = _ring(par.base_radius, at_base)
        self.platform_points = _ring(par.platform_radius, at_platform)
        self.bearing_points = _ring(par.bearing_radius, at_base + side * par.bearing_angle, par.bearing_height)
        self._x = np.array([_unit(m - b) for m, b in zip(self.bearing_points, self.base_points, strict=True)])
        self._side = side
        home = np.array([0.0, 0.0, par.home_height, 0.0, 0.0, 0.0])
        self._home_y, self._home_k = self._directions(home)
        self.home_length = self.lengths(home)
        self._build()

    # -- inverse kinematics -------------------------------------------------------------------------------------
    def _directions(self, pose: Array) -> tuple[Array, Array]:
        """Shift directions y*_i (normal to x*_i, towards the platform) and leg directions K_i."""
        y, k = np.empty((6, 3)), np.empty((6, 3))
        tips = pose[:3] + self.platform_points @ rotation(pose[3:]).T
        for i in range(6):
            w = tips[i] - self.base_points[i]
            y[i] = _unit(w - self._x[i] * (self._x[i] @ w))
            k[i] = _unit(w - self.parameters.shift * y[i])
        return y, k

    def lengths(self, pose: Array) -> Array:
        """Distances from the shifted joint d_i = b_i + c y* to the ball joints."""
        tips = pose[:3] + self.platform_points @ rotation(pose[3:]).T
        y, _ = self._directions(pose)
        return np.linalg.norm(tips - self.base_points - self.parameters.shift * y, axis=1)

    def nut_angles(self, pose: Array) -> Array:
        """phi = 2 pi/lead (L - L_home)."""
        return 2 * np.pi / self.parameters.lead * (self.lengths(pose) - self.home_length)

    def pose(self, phi: Array, start: Array | None = None) -> Array:
        """Direct kinematics by Newton on the lengths, with the velocity map as exact Jacobian."""
        pose = np.array([0, 0, self.parameters.home_height, 0, 0, 0.0]) if start is None else np.array(start, float)
        for _ in range(30):
            gap = phi - self.nut_angles(pose)
            step = self.pose_rate(pose, gap)
            pose = pose + step
            if np.max(np.abs(step)) < 1e-15:
                break
        if np.max(np.abs(phi - self.nut_angles(pose))) > 1e-9:
            raise ArithmeticError("direct kinematics did not converge")
        return pose

    def pose_rate(self, pose: Array, phidot: Array) -> Array:
        """Rates of (tx, ty, tz, ax, ay, az) under the nut rates."""
        twist = self._velocity_map(self.configuration(pose))[-6:] @ phidot  # in the platform's own axes
        ax, ay, _ = pose[3:]
        per_angle_rate = np.array(
            [
                [1, 0, -np.sin(ay)],
                [0, np.cos(ax), np.sin(ax) * np.cos(ay)],
                [0, -np.sin(ax), np.cos(ax) * np.cos(ay)],
            ]
        )
        return np.concatenate([rotation(pose[3:]) @ twist[:3], np.linalg.solve(per_angle_rate, twist[3:])])

    # -- the tree -----------------------------------------------------------------------------------------------
    def _build(self) -> None:
        par, model = self.parameters, pin.Model()
        base = pin.utils.rotate("y", par.tilt[1]) @ pin.utils.rotate("x", par.tilt[0])
        model.gravity.linear = base.T @ np.array([0, 0, -par.gravity])

        def attach(joint: int, body: Body, cg: Array, axes: Array | None = None) -> None:
            tensor = np.diag(body.inertia)
            if axes is not None:
                tensor = axes @ tensor @ axes.T
            model.appendBodyToJoint(joint, pin.Inertia(body.mass, cg, tensor), pin.SE3.Identity())

        self._nuts, self._screws, self._tips, self._links = [], [], [], []
        for i in range(6):
            x, y = self._x[i], self._home_y[i]
            k = self._home_k[i]
            # the second joint axis x* x y* and the body axes at assembly (home), fixed to the link from then on
            first = pin.SE3(np.column_stack([x, y, np.cross(x, y)]), self.base_points[i])
            tilt = np.arctan2(-k @ x, k @ y)  # about x* x y*, from y* to K
            swing = model.addJoint(0, pin.JointModelRX(), first, f"swing{i}")
            link = model.addJoint(
                swing, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0, par.shift, 0])), f"link{i}"
            )
            # axes (I, J, K) of the link seen from its joint frame, whose second axis is K when the joint turns by tilt
            at_home = first.rotation @ pin.utils.rotate("z", tilt)
            i_axis = par.offset_sign * self._side[i] * _unit(np.cross(k, [0.0, 0.0, 1.0]))
            axes = at_home.T @ np.column_stack([i_axis, np.cross(k, i_axis), k])
            attach(link, par.lower_link, axes @ [0, 0, par.lower_link_cg], axes)
            attach(link, par.motor, axes @ (np.array(par.motor_offset) + np.array([0, 0, par.motor_cg])), axes)
            at_nut = pin.SE3(axes, axes @ [0, 0, par.nut_origin])
            nut = model.addJoint(link, pin.JointModelRZ(), at_nut, f"nut{i}")
            attach(nut, par.nut, np.array([0, 0, par.nut_cg]))
            screw = model.addJoint(link, pin.JointModelPZ(), pin.SE3(axes, np.zeros(3)), f"screw{i}")
            attach(screw, par.ball_screw, np.array([0, 0, -par.screw_cg]))
            self._links.append((swing, link))
            self._nuts.append(nut)
            self._screws.append(screw)
        self._platform = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "platform")
        attach(self._platform, par.platform, np.array(par.platform_cg))
        for i in range(6):
            tip = pin.Frame(f"tip{i}", self._screws[i], 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
            seat = pin.Frame(
                f"seat{i}", self._platform, 0, pin.SE3(np.eye(3), self.platform_points[i]), pin.FrameType.OP_FRAME
            )
            self._tips.append((model.addFrame(tip), model.addFrame(seat)))
        self.model, self.data = model, model.createData()
        self._S = np.zeros((6, model.nv))
        self._coupling = np.zeros((6, model.nv))
        for i in range(6):
            nut, screw = model.joints[self._nuts[i]].idx_v, model.joints[self._screws[i]].idx_v
            self._S[i, nut] = 1.0
            self._coupling[i, nut], self._coupling[i, screw] = par.lead / (2 * np.pi), -1.0

    def configuration(self, pose: Array) -> Array:
        """Tree coordinates that close the loops at the pose."""
        q = pin.neutral(self.model)
        y, k = self._directions(pose)
        lengths, phi = self.lengths(pose), self.nut_angles(pose)
        for i in range(6):
            swing, link = self._links[i]
            x, y0 = self._x[i], self._home_y[i]
            values = {
                swing: np.arctan2(y[i] @ np.cross(x, y0), y[i] @ y0),
                link: np.arctan2(-k[i] @ x, k[i] @ y[i]),
                self._nuts[i]: phi[i],
                self._screws[i]: lengths[i],
            }
            for joint, value in values.items():
                q[self.model.joints[joint].idx_q] = value
        at = self.model.joints[self._platform].idx_q
        q[at : at + 3] = pose[:3]
        q[at + 3 : at + 7] = pin.Quaternion(rotation(pose[3:])).coeffs()
        return q

    def closure(self, pose: Array) -> Array:
        """Gap vectors of the six ball joints (6, 3): zero when the loops are closed."""
        pin.framesForwardKinematics(self.model, self.data, self.configuration(pose))
        return np.array([self.data.oMf[a].translation - self.data.oMf[b].translation for a, b in self._tips])

    # -- the reduction ------------------------------------------------------------------------------------------
    def _constraints(self, q: Array) -> Array:
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        rows = []
        for tip, seat in self._tips:
            a = pin.getFrameJacobian(self.model, self.data, tip, pin.LOCAL_WORLD_ALIGNED)[:3]
            b = pin.getFrameJacobian(self.model, self.data, seat, pin.LOCAL_WORLD_ALIGNED)[:3]
            rows.append(a - b)
        return np.vstack([*rows, self._coupling, self._S])

    def _velocity_map(self, q: Array) -> Array:
        return np.linalg.solve(self._constraints(q), np.vstack([np.zeros((24, 6)), np.eye(6)]))

    def _drift(self, q: Array, v: Array) -> Array:
        """Cdot v of the closing constraints, from the classical accelerations of the joints' points at vdot = 0."""
        pin.forwardKinematics(self.model, self.data, q, v, np.zeros(self.model.nv))
        pin.updateFramePlacements(self.model, self.data)
        drift = np.zeros(30)
        for i, (tip, seat) in enumerate(self._tips):
            a = pin.getFrameClassicalAcceleration(self.model, self.data, tip, pin.LOCAL_WORLD_ALIGNED).linear
            b = pin.getFrameClassicalAcceleration(self.model, self.data, seat, pin.LOCAL_WORLD_ALIGNED).linear
            drift[3 * i : 3 * i + 3] = a - b
        return drift

    def mass_matrix(self, pose: Array) -> Array:
        """M(pose), 6 x 6, in nut coordinates."""
        q = self.configuration(pose)
        W = self._velocity_map(q)
        M = pin.crba(self.model, self.data, q)
        M = np.triu(M) + np.triu(M, 1).T
        return W.T @ M @ W + self.parameters.rotor_inertia * self.parameters.gear**2 * np.eye(6)

    def gravity_torque(self, pose: Array) -> Array:
        """dV/dphi, N m at the nuts."""
        q = self.configuration(pose)
        return self._velocity_map(q).T @ pin.computeGeneralizedGravity(self.model, self.data, q)

    def trim_torque(self, pose: Array) -> Array:
        """Holding torque at the motor shafts."""
        return self.gravity_torque(pose) / self.parameters.gear

    def bias_torque(self, pose: Array, phidot: Array) -> Array:
        """Gravity, centrifugal and Coriolis torque at the nuts."""
        q = self.configuration(pose)
        A = self._constraints(q)
        W = np.linalg.solve(A, np.vstack([np.zeros((24, 6)), np.eye(6)]))
        v = W @ phidot
        h = np.linalg.solve(A, -self._drift(q, v))
        return W.T @ pin.rnea(self.model, self.data, q, v, h)

    def nut_acceleration(self, pose: Array, phidot: Array, u: Array) -> Array:
        """phidd under the motor shaft torques u."""
        torque = self.parameters.gear * np.asarray(u) - self.bias_torque(pose, phidot)
        return np.linalg.solve(self.mass_matrix(pose), torque)

    def potential_energy(self, pose: Array) -> float:
        """V over the base plane z = 0."""
        return float(pin.computePotentialEnergy(self.model, self.data, self.configuration(pose)))

    def kinetic_energy(self, pose: Array, phidot: Array) -> float:
        """T by Pinocchio's own sum over bodies, plus the rotors."""
        q = self.configuration(pose)
        v = self._velocity_map(q) @ phidot
        par = self.parameters
        return float(pin.computeKineticEnergy(self.model, self.data, q, v)) + 0.5 * par.rotor_inertia * float(
            np.sum((par.gear * np.asarray(phidot)) ** 2)
        )
