"""Attitude, body to world: quaternions (scalar first), matrices, axis and angle, Euler angles, MRP; rigid bodies."""

from astrojax.attitude.euler import (
    SEQUENCES,
    euler_derivative,
    euler_rates_to_omega,
    euler_to_quat,
    euler_to_rotation,
    rotation_to_euler,
)
from astrojax.attitude.matrix import (
    axis_angle_to_quat,
    quat_to_axis_angle,
    rotation_derivative,
    rotation_from_rotation_vector,
    rotation_to_rotation_vector,
    skew,
)
from astrojax.attitude.mrp import mrp_derivative, mrp_shadow, mrp_switch, mrp_to_quat, mrp_to_rotation, quat_to_mrp
from astrojax.attitude.quaternion import (
    quat_angle,
    quat_conjugate,
    quat_derivative,
    quat_from_rotation_vector,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_sign,
    quat_to_rotation,
    quat_to_rotation_vector,
    rotation_to_quat,
)
from astrojax.attitude.rigid_body import accel_euler, torque_gravity_gradient

__all__ = [
    "SEQUENCES",
    "accel_euler",
    "axis_angle_to_quat",
    "euler_derivative",
    "euler_rates_to_omega",
    "euler_to_quat",
    "euler_to_rotation",
    "mrp_derivative",
    "mrp_shadow",
    "mrp_switch",
    "mrp_to_quat",
    "mrp_to_rotation",
    "quat_angle",
    "quat_conjugate",
    "quat_derivative",
    "quat_from_rotation_vector",
    "quat_multiply",
    "quat_normalize",
    "quat_rotate",
    "quat_sign",
    "quat_to_axis_angle",
    "quat_to_mrp",
    "quat_to_rotation",
    "quat_to_rotation_vector",
    "rotation_derivative",
    "rotation_from_rotation_vector",
    "rotation_to_euler",
    "rotation_to_quat",
    "rotation_to_rotation_vector",
    "skew",
    "torque_gravity_gradient",
]
