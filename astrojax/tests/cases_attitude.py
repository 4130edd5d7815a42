"""Conformance cases of matrices, axis and angle, Euler angles and modified Rodrigues parameters."""

import functools

import numpy as np

from astrojax import attitude

A = np.array
Q = A([0.2, -0.5, 0.6, 0.3]) / np.linalg.norm([0.2, -0.5, 0.6, 0.3])
OMEGA = A([0.01, -0.02, 0.03])
ANGLES = A([0.4, 1.1, -2.0])
MRP = A([0.3, -0.2, 0.4])
AXIS = A([2.0, -1.0, 2.0]) / 3.0


def _matrix(q):
    w, v = q[0], q[1:]
    skew = A([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew


def cases(case):
    def of(name, sequence):
        return functools.partial(getattr(attitude, name), sequence=sequence)

    both = ("ZYX", "ZXZ")
    return [
        *(case(f"{name}/{s}", of(name, s), (ANGLES,)) for name in ("euler_to_rotation", "euler_to_quat") for s in both),
        *(case(f"rotation_to_euler/{s}", of("rotation_to_euler", s), (_matrix(Q),)) for s in both),
        *(
            case(f"{name}/{s}", of(name, s), (ANGLES, OMEGA))
            for name in ("euler_derivative", "euler_rates_to_omega")
            for s in both
        ),
        case("skew", attitude.skew, (OMEGA,)),
        case("axis_angle_to_quat", attitude.axis_angle_to_quat, (AXIS, A(2.0)), (AXIS, A(-7.0))),
        case("quat_to_axis_angle", attitude.quat_to_axis_angle, (Q,), (-Q,)),
        case("rotation_from_rotation_vector", attitude.rotation_from_rotation_vector, (ANGLES,), (1e-3 * ANGLES,)),
        case("rotation_to_rotation_vector", attitude.rotation_to_rotation_vector, (_matrix(Q),)),
        case("rotation_derivative", attitude.rotation_derivative, (_matrix(Q), OMEGA)),
        case("quat_to_mrp", attitude.quat_to_mrp, (Q,), (-Q,)),
        case("mrp_to_quat", attitude.mrp_to_quat, (MRP,), (4.0 * MRP,)),
        case("mrp_to_rotation", attitude.mrp_to_rotation, (MRP,)),
        case("mrp_shadow", attitude.mrp_shadow, (MRP,)),
        case("mrp_switch", attitude.mrp_switch, (MRP,), (4.0 * MRP,)),
        case("mrp_derivative", attitude.mrp_derivative, (MRP, OMEGA)),
    ]
