"""Attitude: quaternions (scalar first, body to world) and rigid bodies."""

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
    "accel_euler",
    "quat_angle",
    "quat_conjugate",
    "quat_derivative",
    "quat_from_rotation_vector",
    "quat_multiply",
    "quat_normalize",
    "quat_rotate",
    "quat_sign",
    "quat_to_rotation",
    "quat_to_rotation_vector",
    "rotation_to_quat",
    "torque_gravity_gradient",
]
