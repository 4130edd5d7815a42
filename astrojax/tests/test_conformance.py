"""What holds for every physics function: dtype, jit, vmap, gradients, one trace a shape.

The cases are example calls of every public function, on both sides of each of its branches.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import astrojax
from astrojax import (
    atmosphere,
    attitude,
    drag,
    dynamics,
    elements,
    ephemeris,
    gravity,
    integrators,
    relative,
    third_body,
    time,
)

STEP = 2e-6  # of each argument's scale, for central differences

# Covered by their parts or by tests of their own.
NOT_PHYSICS = {"mjd_from_calendar", "celestial_bodies", "phase"}


class Case(NamedTuple):
    label: str
    fn: Callable[..., Any]
    args: tuple[np.ndarray, ...]
    float32_rtol: float = 3e-6  # of the output's largest component
    gradient_rtol32: float = 1e-3


def _unit(q):
    q = np.asarray(q, float)
    return q / np.linalg.norm(q)


LEO = np.array([-3.9e6, 4.4e6, 3.4e6])
LEO_V = np.array([-5.1e3, -5.3e3, 1.7e3])
STATE = np.concatenate([LEO, LEO_V])
DEPUTY = STATE + np.array([120.0, -80.0, 40.0, 0.3, -0.2, 0.1])
SUN = np.array([-9.4e10, 1.09e11, 4.7e10])
MOON = np.array([3.58e8, -1.49e8, -6.0e7])
INERTIA = np.array([[8.0e4, 300.0, -200.0], [300.0, 8.1e4, 500.0], [-200.0, 500.0, 5.0e4]])
ELEMENTS = np.array([6.795e6, 0.0005, 0.9, 1.1, 0.4, 2.0])
Q1, Q2 = _unit([0.2, -0.5, 0.6, 0.3]), _unit([-0.7, 0.1, 0.2, 0.5])
A = np.array


def _along(height):
    return _unit([0.4, -0.5, 0.3]) * (6371e3 + height)


def _near_pi(sign):
    return np.concatenate([[sign * 1e-3], _unit([1.0, -2.0, 0.5])])


def _bodies(dtype):
    return dynamics.Bodies(jnp.asarray(SUN, dtype), jnp.asarray(MOON, dtype))


def _rk4(state, dt, gm):
    def f(t, y):
        return {"r": y["v"], "v": gravity.accel_two_body(y["r"], gm)}

    return integrators.rk4_step(f, 0.0, {"r": state[:3], "v": state[3:]}, dt)


def _derivative(state, mass):
    params = dynamics.OrbitParams(_bodies(state.dtype), mass, 50.0, 2.2)
    return dynamics.derivative(0.0, state, params, dynamics.ForceModel(drag=False))


def _forces(model, state, mass):
    return dynamics.accel_gravity_and_perturbations(_bodies(state.dtype), state, mass, 50.0, 2.2, model)


_HP = atmosphere.density_harris_priester
_STM = relative.stm_hcw


def _matrix(q):
    w, x, y, z = q
    v = np.array([x, y, z])
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew


CASES = [
    # time and ephemeris: the day stays an exact whole number
    Case("gmst", functools.partial(time.gmst, 61253), (A(43210.0),)),
    Case("julian_centuries_tt", functools.partial(time.julian_centuries_tt, 61253), (A(43210.0),)),
    Case("sun_position", functools.partial(ephemeris.sun_position, 61253), (A(43210.0),), 1e-5, 1e-2),
    Case("moon_position", functools.partial(ephemeris.moon_position, 61253), (A(43210.0),), 3e-5, 1e-2),
    Case("normalize_epoch/over", time.normalize_epoch, (A(61253.0), A(100000.0))),
    Case("normalize_epoch/under", time.normalize_epoch, (A(61253.0), A(-1000.0))),
    Case("utc_to_tt", time.utc_to_tt, (A(61253.0), A(86380.0)), 1e-4),
    Case("utc_to_tai", time.utc_to_tai, (A(61253.0), A(100.0))),
    # elements
    Case("mean_motion", elements.mean_motion, (A(6.795e6), A(3.986e14))),
    Case("solve_kepler/low", elements.solve_kepler, (A(2.0), A(0.01))),
    Case("solve_kepler/high", elements.solve_kepler, (A(-0.3), A(0.8)), 1e-5),
    Case("propagate_keplerian", elements.propagate_keplerian, (ELEMENTS, A(60.0), A(3.986e14))),
    Case("keplerian_to_cartesian", elements.keplerian_to_cartesian, (ELEMENTS, A(3.986e14))),
    Case(
        "keplerian_to_cartesian/circular",
        elements.keplerian_to_cartesian,
        (A([7e6, 1e-5, 0.5, 0.2, 0.1, -2.0]), A(3.986e14)),
    ),
    Case(
        "cartesian_to_keplerian/eccentric",
        elements.cartesian_to_keplerian,
        (A([7e6, 1e5, -2e5, 1e2, 5.6e3, 6.5e3]), A(3.986e14)),
        1e-5,
        1e-2,
    ),
    Case("cartesian_to_keplerian/leo", elements.cartesian_to_keplerian, (STATE, A(3.986e14)), 1e-5, 1e-1),
    # forces
    Case("accel_two_body", gravity.accel_two_body, (LEO, A(3.986e14))),
    *(
        Case(f"accel_zonal/{n}", functools.partial(gravity.accel_zonal, degree=n), (LEO,))
        for n in range(2, 7)
    ),
    Case("accel_zonal/pole", functools.partial(gravity.accel_zonal, degree=6), (A([0.0, 0.0, 7e6]),)),
    Case("accel_third_body/sun", third_body.accel_third_body, (LEO, SUN, A(1.327e20)), 3e-6, 2e-3),
    Case("accel_third_body/moon", third_body.accel_third_body, (LEO, MOON, A(4.9e12))),
    Case("geodetic_height", atmosphere.harris_priester.geodetic_height, (LEO,), 1e-5),
    Case("geodetic_height/pole", atmosphere.harris_priester.geodetic_height, (A([0.0, 0.0, -6.8e6]),), 1e-5),
    Case("density_harris_priester/sea", _HP, (_along(-20e3), SUN), 1e-3, 1e-2),
    Case("density_harris_priester/low", _HP, (_along(60e3), SUN), 1e-3, 1e-2),
    Case("density_harris_priester/first", _HP, (_along(107e3), SUN), 1e-3, 1e-2),
    Case("density_harris_priester/iss", _HP, (_along(413e3), SUN), 1e-4, 1e-2),
    Case("density_harris_priester/last", _HP, (_along(985e3), SUN), 1e-4, 1e-2),
    Case("density_harris_priester/above", _HP, (_along(1200e3), SUN)),
    Case("density_harris_priester/exponent", _HP, (_along(413e3), SUN, A(3.3)), 1e-4, 1e-2),
    Case("accel_drag", drag.accel_drag, (LEO, LEO_V, A(3e-12), A(1.2e4), A(50.0), A(2.2))),
    Case(
        "accel_gravity_and_perturbations",
        functools.partial(_forces, dynamics.ForceModel()),
        (STATE, A(1.2e4)),
    ),
    Case(
        "accel_gravity_and_perturbations/two-body",
        functools.partial(_forces, dynamics.ForceModel(0, False, False, False)),
        (STATE, A(1.2e4)),
    ),
    Case("derivative", _derivative, (STATE, A(1.2e4))),
    Case("rk4_step", _rk4, (STATE, A(10.0), A(3.986e14))),
    # relative motion
    Case("rotation_eci_to_rtn", relative.rotation_eci_to_rtn, (STATE,)),
    Case("rtn_rate", relative.rtn_rate, (STATE, A([1.0, -2.0, 3.0]))),
    Case("state_eci_to_rtn", relative.state_eci_to_rtn, (STATE, DEPUTY), 2e-2),
    Case("state_eci_to_rtn/rate", relative.state_eci_to_rtn, (STATE, DEPUTY, A([1.0, -2.0, 3.0])), 2e-2),
    Case("state_rtn_to_eci", relative.state_rtn_to_eci, (STATE, A([100.0, 50.0, -20.0, 0.1, 0.2, 0.3]))),
    Case("accel_hcw", relative.accel_hcw, (A([100.0, 50.0, -20.0, 0.1, 0.2, 0.3]), A(1.1e-3))),
    Case("stm_hcw/short", _STM, (A(1.1e-3), A(0.05))),
    Case("stm_hcw/before", _STM, (A(1.1e-3), A(450.0))),
    Case("stm_hcw/after", _STM, (A(1.1e-3), A(460.0))),
    Case("stm_hcw/orbit", _STM, (A(1.1e-3), A(5700.0)), 1e-5),
    # attitude
    Case("quat_multiply", attitude.quat_multiply, (Q1, Q2)),
    Case("quat_conjugate", attitude.quat_conjugate, (Q1,)),
    Case("quat_normalize", attitude.quat_normalize, (3.0 * Q1,)),
    Case("quat_rotate", attitude.quat_rotate, (Q1, A([1.0, 2.0, -3.0]))),
    Case("quat_to_rotation", attitude.quat_to_rotation, (Q1,)),
    *(
        Case(f"rotation_to_quat/{name}", attitude.rotation_to_quat, (_matrix(_unit(q)),))
        for name, q in {
            "w": [0.9, 0.2, -0.3, 0.1],
            "x": [0.1, 0.9, -0.3, 0.2],
            "y": [-0.2, 0.1, 0.9, 0.3],
            "z": [0.0, -0.3, 0.2, 0.9],
        }.items()
    ),
    *(
        Case(
            f"quat_from_rotation_vector/{angle}",
            attitude.quat_from_rotation_vector,
            (angle * _unit([1, -2, 0.5]),),
        )
        for angle in (0.0, 1e-4, 0.0099, 0.0101, 2.0, 3.2)
    ),
    *(
        Case(
            f"quat_to_rotation_vector/{angle}",
            attitude.quat_to_rotation_vector,
            (np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * _unit([1, -2, 0.5])]),),
        )
        for angle in (0.0, 1e-4, 0.0199, 0.0201, 2.0, 4.0, 2 * np.pi - 1e-3)
    ),
    Case("quat_to_rotation_vector/pi-", attitude.quat_to_rotation_vector, (_near_pi(1.0),)),
    Case("quat_to_rotation_vector/pi+", attitude.quat_to_rotation_vector, (_near_pi(-1.0),)),
    Case("quat_derivative", attitude.quat_derivative, (Q1, A([0.01, -0.02, 0.03]))),
    Case("quat_angle", attitude.quat_angle, (Q1, Q2)),
    Case("quat_angle/opposite", attitude.quat_angle, (Q1, -Q1 + A([1e-2, 0, -1e-2, 0])), 1e-4),
    Case("accel_euler", attitude.accel_euler, (A([0.01, -0.02, 0.03]), INERTIA, A([10.0, -5.0, 2.0])), 1e-5),
    Case("torque_gravity_gradient", attitude.torque_gravity_gradient, (LEO, INERTIA, A(3.986e14)), 1e-5),
]


def cast(args, dtype):
    return tuple(jnp.asarray(a, dtype) for a in args)


def flat_function(fn, args):
    """`fn` as a map from one vector to one vector, in units of each argument's scale."""
    sizes = np.cumsum([a.size for a in args])[:-1]
    # States and elements mix units: their scale is each component's size, that of the rest the norm.
    scales = [np.abs(a) if a.shape == (6,) else (np.linalg.norm(a) or 1.0) * np.ones(a.size) for a in args]

    def flat(z):
        parts = jnp.split(z, sizes)
        return ravel_pytree(
            fn(*(jnp.reshape(p * s.astype(z.dtype), a.shape) for p, s, a in zip(parts, scales, args)))
        )[0]

    start = np.concatenate([np.ravel(a) / s for a, s in zip(args, scales)])
    return flat, start


def close(actual, expected, rtol):
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * float(np.max(np.abs(b))) + 1e-300)


def quick_compile_options():
    """Compiler options that skip optimisation, where JAX has them: most of the time goes into compiling."""
    options = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x, compiler_options=options)(1.0)
    except jax.errors.JaxRuntimeError:
        return None
    return options


@pytest.fixture(scope="module")
def quick():
    return functools.partial(jax.jit, compiler_options=quick_compile_options())


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.label)
def test_values(case, quick, x64):
    """jit = eager, vmap = loop, float32 in gives float32 out (close to float64), one trace for both calls."""
    traces = []

    def counted(*args):
        traces.append(1)
        return case.fn(*args)

    args = cast(case.args, jnp.float64)
    eager = case.fn(*args)
    compiled = jax.jit(counted)  # fully optimised: reassociation is part of what is tested
    close(compiled(*args), eager, 1e-12)
    factors = jnp.asarray([1.0, 1.0 + 1e-4, 1.0 - 1e-4])
    batch = tuple(a * factors.reshape((3,) + (1,) * a.ndim) for a in args)
    looped = [compiled(*(b[i] for b in batch)) for i in range(3)]
    assert len(traces) == 1
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *looped)
    close(quick(jax.vmap(case.fn))(*batch), stacked, 1e-12)

    narrow = compiled(*cast(case.args, jnp.float32))
    assert {leaf.dtype for leaf in jax.tree.leaves(eager)} == {jnp.dtype("float64")}
    assert {leaf.dtype for leaf in jax.tree.leaves(narrow)} == {jnp.dtype("float32")}
    close(narrow, eager, case.float32_rtol)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.label)
def test_gradients(case, quick, x64):
    """Reverse mode = central difference in float64; finite and close to it in float32."""
    flat, start = flat_function(case.fn, case.args)
    offsets = np.concatenate([STEP * np.eye(start.size), -STEP * np.eye(start.size)])
    values = quick(jax.vmap(flat))(jnp.asarray(start + offsets, jnp.float64))
    plus, minus = np.split(np.asarray(values), 2)
    difference = (plus - minus).T / (2 * STEP)
    size, noise = np.max(np.abs(difference)), 1e-10 * np.max(np.abs(plus))

    gradient = quick(jax.jacrev(flat))
    wide = gradient(jnp.asarray(start, jnp.float64))
    np.testing.assert_allclose(wide, difference, rtol=0, atol=1e-6 * size + noise)
    narrow = gradient(jnp.asarray(start, jnp.float32))
    assert narrow.dtype == jnp.float32
    np.testing.assert_allclose(narrow, wide, rtol=0, atol=case.gradient_rtol32 * size + 1e-300)


def test_every_public_function_has_a_case():
    covered = {case.label.split("/")[0] for case in CASES}
    for name in astrojax.__all__:
        module = getattr(astrojax, name)
        for attribute, value in vars(module).items():
            public = inspect.isfunction(value) and not attribute.startswith("_")
            if public and inspect.getmodule(value).__name__.startswith(f"astrojax.{name}"):
                assert attribute in covered | NOT_PHYSICS, f"{name}.{attribute} has no conformance case"


@pytest.mark.parametrize("label", ["moon_position", "accel_gravity_and_perturbations", "quat_angle"])
def test_float32_without_x64(label):
    """JAX's default configuration runs them too."""
    case = next(case for case in CASES if case.label == label)
    out = jax.jit(case.fn)(*cast(case.args, jnp.float32))
    assert out.dtype == jnp.float32
    assert np.all(np.isfinite(out))
