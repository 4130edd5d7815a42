"""Numerical integration of any pytree."""

from astrojax.propagate.runge_kutta import compensated_add, rk4_increment, rk4_increment_looped, rk4_step

__all__ = [
    "compensated_add",
    "rk4_increment",
    "rk4_increment_looped",
    "rk4_step",
]
