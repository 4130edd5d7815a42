"""What holds for every physics function: dtype, jit, vmap, gradients, one trace a shape.

The cases are example calls of every public function, on both sides of each of its branches.
"""

import functools
import inspect
import pathlib
import re
import runpy
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import astrojax
from astrojax import attitude, compilation, ephemeris, forces, frames, orbits, propagate, time

STEP = 2e-6  # of each argument's scale, for central differences

# Covered by their parts or by tests of their own.
NOT_PHYSICS = {"mjd_from_calendar", "phase"}


class Case(NamedTuple):
    name: str
    fn: Callable[..., Any]
    points: tuple[tuple[np.ndarray, ...], ...]
    rtol32: float  # float32 against float64, of the output's largest component
    gradient_rtol32: float  # the same of the largest derivative


def case(name, fn, *points, rtol32=3e-6, gradient_rtol32=1e-3):
    return Case(name, fn, points, rtol32, gradient_rtol32)


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


def _at_height(height):
    return _unit([0.4, -0.5, 0.3]) * (6371e3 + height)


def _behind_the_earth(angle):
    """413 km up, `angle` [rad] away from the point opposite the Sun."""
    shadow = -_unit(SUN)
    return 6791e3 * (np.cos(angle) * shadow + np.sin(angle) * _unit(np.cross(shadow, [0.3, 0.2, 0.9])))


AXIS = _unit([1.0, -2.0, 0.5])


def _turned(angle):
    return (np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * AXIS]),)


def _rk4(state, dt, gm):
    def f(t, y):
        return {"r": y["v"], "v": forces.accel_two_body(y["r"], gm)}

    return propagate.rk4_step(f, 0.0, {"r": state[:3], "v": state[3:]}, dt)


def _rk4_increment(state, dt, gm):
    def f(t, y):
        return jnp.concatenate([y[3:], forces.accel_two_body(y[:3], gm)])

    return propagate.rk4_increment(f, 0.0, state, dt)


def _rk4_increment_looped(state, dt, gm):
    def f(t, y, gm):
        return jnp.concatenate([y[3:], forces.accel_two_body(y[:3], gm)])

    return propagate.rk4_increment_looped(f, jnp.zeros_like(dt), state, dt, (gm,))


def _compensated(y, lost, increment):
    """The sum alone: what it has lost is rounding, of no agreed value."""
    total, lost = propagate.compensated_add({"y": y}, {"y": lost}, {"y": increment})
    return total["y"] - lost["y"]


_STM = orbits.stm_hcw


def _matrix(q):
    w, x, y, z = _unit(q)
    v = np.array([x, y, z])
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew


GM = A(3.986e14)
ACCEL = A([1.0, -2.0, 3.0])
REL = A([100.0, 50.0, -20.0, 0.1, 0.2, 0.3])

CASES = [
    # time and ephemeris: the day stays an exact whole number
    case("gmst", functools.partial(time.gmst, 61253), (A(43210.0),)),
    case("julian_centuries_tt", functools.partial(time.julian_centuries_tt, 61253), (A(43210.0),)),
    case(
        "sun_position",
        functools.partial(ephemeris.sun_position, 61253),
        (A(43210.0),),
        rtol32=1e-5,
        gradient_rtol32=1e-2,
    ),
    case("moon_position", functools.partial(ephemeris.moon_position, 61253), (A(43210.0),), rtol32=1e-5),
    case("normalize_epoch", time.normalize_epoch, (A(61253.0), A(100000.0)), (A(61253.0), A(-1000.0))),
    case("utc_to_tt", time.utc_to_tt, (A(61253.0), A(86380.0)), rtol32=1e-4),
    case("utc_to_tai", time.utc_to_tai, (A(61253.0), A(100.0))),
    # elements
    case("mean_motion", orbits.mean_motion, (A(6.795e6), GM)),
    case("solve_kepler", orbits.solve_kepler, (A(2.0), A(0.01)), (A(-0.3), A(0.8)), rtol32=1e-5),
    case("propagate_keplerian", orbits.propagate_keplerian, (ELEMENTS, A(60.0), GM), (ELEMENTS, A(-6000.0), GM)),
    case("secular_rates_j2", orbits.secular_rates_j2, (ELEMENTS, GM)),
    case(
        "keplerian_to_cartesian",
        orbits.keplerian_to_cartesian,
        (ELEMENTS, GM),
        (A([7e6, 1e-5, 0.5, 0.2, 0.1, -2.0]), GM),
    ),
    case(
        "cartesian_to_keplerian",
        orbits.cartesian_to_keplerian,
        (A([7e6, 1e5, -2e5, 1e2, 5.6e3, 6.5e3]), GM),
        (STATE, GM),
        rtol32=1e-5,
        gradient_rtol32=1e-1,
    ),
    # forces
    case("accel_two_body", forces.accel_two_body, (LEO, GM)),
    *(
        case(f"accel_zonal/{n}", functools.partial(forces.accel_zonal, degree=n), (LEO,), (A([0.0, 0.0, 7e6]),))
        for n in (2, 4, 5, 6)
    ),
    case(
        "accel_third_body",
        forces.accel_third_body,
        (LEO, SUN, A(1.327e20)),
        (LEO, MOON, A(4.9e12)),
        gradient_rtol32=2e-3,
    ),
    case(
        "geodetic_height",
        frames.geodetic_height,
        (LEO,),
        (A([0.0, 0.0, -6.8e6]),),
        rtol32=1e-5,
    ),
    case(
        "density_harris_priester",
        forces.density_harris_priester,
        *((_at_height(h), SUN) for h in (-20e3, 60e3, 107e3, 413e3, 985e3, 1200e3)),  # either side of each bound
        rtol32=1e-3,
        gradient_rtol32=1e-2,
    ),
    case(
        "density_harris_priester/exponent",
        forces.density_harris_priester,
        (_at_height(413e3), SUN, A(3.3)),
        rtol32=1e-4,
        gradient_rtol32=1e-2,
    ),
    case(
        "illumination_conical",
        ephemeris.illumination_conical,
        *((_behind_the_earth(angle), SUN) for angle in (0.5, 1.2181, 1.2223, 1.2257, 1.4)),  # umbra, penumbra, sunlight
        rtol32=1e-4,
        gradient_rtol32=1e-2,
    ),
    case("eclipse_angles", ephemeris.eclipse_angles, (_behind_the_earth(1.2223), SUN), (LEO, SUN), rtol32=1e-5),
    case("accel_drag", forces.accel_drag, (LEO, LEO_V, A(3e-12), A(1.2e4), A(50.0), A(2.2))),
    case("rk4_step", _rk4, (STATE, A(10.0), GM)),
    case("rk4_increment", _rk4_increment, (STATE, A(10.0), GM)),
    case("rk4_increment_looped", _rk4_increment_looped, (STATE, A(10.0), GM)),
    case("compensated_add", _compensated, (ACCEL, A([1e-4, -2e-4, 3e-4]), 1e-3 * ACCEL)),
    case("stored", compilation.stored, (ACCEL,)),
    # relative motion
    case("rotation_eci_to_rtn", frames.rotation_eci_to_rtn, (STATE,)),
    case("rtn_rate", frames.rtn_rate, (STATE, ACCEL)),
    case("state_eci_to_rtn", frames.state_eci_to_rtn, (STATE, DEPUTY), rtol32=2e-2),
    case("state_eci_to_rtn/rate", frames.state_eci_to_rtn, (STATE, DEPUTY, ACCEL), rtol32=2e-2),
    case("state_rtn_to_eci", frames.state_rtn_to_eci, (STATE, REL, ACCEL)),
    case("accel_hcw", orbits.accel_hcw, (REL, A(1.1e-3))),
    case("stm_hcw", orbits.stm_hcw, *((A(1.1e-3), A(t)) for t in (0.05, 450.0, 460.0, 5700.0)), rtol32=1e-5),
    # attitude
    case("quat_multiply", attitude.quat_multiply, (Q1, Q2)),
    case("quat_conjugate", attitude.quat_conjugate, (Q1,)),
    case("quat_normalize", attitude.quat_normalize, (3.0 * Q1,)),
    case("quat_sign", attitude.quat_sign, (Q1, Q2), (-Q1, Q1)),
    case("quat_rotate", attitude.quat_rotate, (Q1, ACCEL)),
    case("quat_to_rotation", attitude.quat_to_rotation, (Q1,)),
    case(
        "rotation_to_quat",
        attitude.rotation_to_quat,
        (_matrix([0.9, 0.2, -0.3, 0.1]),),
        (_matrix([0.1, 0.9, -0.3, 0.2]),),
        (_matrix([-0.2, 0.1, 0.9, 0.3]),),
        (_matrix([0.0, -0.3, 0.2, 0.9]),),
    ),
    case(
        "quat_from_rotation_vector",
        attitude.quat_from_rotation_vector,
        *((angle * AXIS,) for angle in (0.0, 1e-4, 0.0099, 0.0101, 2.0, 3.2)),
    ),
    case(
        "quat_to_rotation_vector",
        attitude.quat_to_rotation_vector,
        *(_turned(a) for a in (0.0, 1e-4, 0.0199, 0.0201, 2.0, np.pi - 1e-3, np.pi + 1e-3, 4.0, 2 * np.pi - 1e-3)),
    ),
    case("quat_derivative", attitude.quat_derivative, (Q1, A([0.01, -0.02, 0.03]))),
    case("quat_angle", attitude.quat_angle, (Q1, Q2), (Q1, -Q1 + A([1e-2, 0, -1e-2, 0])), rtol32=1e-4),
    case("accel_euler", attitude.accel_euler, (A([0.01, -0.02, 0.03]), INERTIA, A([10.0, -5.0, 2.0])), rtol32=1e-5),
    case("torque_gravity_gradient", attitude.torque_gravity_gradient, (LEO, INERTIA, GM), rtol32=1e-5),
]
# Each topic's own cases, and what of it is no physics.
TOPICS = [runpy.run_path(str(path)) for path in sorted(pathlib.Path(__file__).parent.glob("cases_*.py"))]
CASES += [c for topic in TOPICS for c in topic["cases"](case)]
NOT_PHYSICS |= {name for topic in TOPICS for name in topic.get("HOST", ())}


def cast(args, dtype):
    return tuple(jnp.asarray(a, dtype) for a in args)


def sizes(args):
    """The scale of each number of the arguments: they are told apart by it, and derivatives are by it."""
    # States and elements mix units: their scale is each component's size, that of the rest the norm.
    scales = [np.abs(a) if a.shape == (6,) else (np.linalg.norm(a) or 1.0) * np.ones(a.size) for a in args]
    return np.concatenate([np.ravel(s) for s in scales])


def shifted(args):
    """The arguments, stacked: each number in turn moved up by a step of its scale, then each moved down."""
    steps = STEP * np.diag(sizes(args))
    moved = np.concatenate([np.ravel(a) for a in args]) + np.concatenate([steps, -steps])
    parts = np.split(moved, np.cumsum([a.size for a in args])[:-1], axis=1)
    return tuple(np.reshape(part, (-1, *a.shape)) for part, a in zip(parts, args))


def pulled(fn):
    """Reverse mode, a row of the Jacobian a call: half as much to compile as `jax.jacrev`, which batches the rows."""

    def row(args, weights):
        out, back = jax.vjp(fn, *args)
        return ravel_pytree(back(ravel_pytree(out)[1](weights)))[0]

    return row


def close(actual, expected, rtol):
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * float(np.max(np.abs(b))) + 1e-300)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_values_and_gradients(case, quick, optimised, x64):
    """jit = eager, vmap = loop, float32 in gives float32 out (close to float64), one trace for all points.

    Reverse mode = central difference in float64; finite and close to it in float32. The difference is taken of what
    is compared with the loop, so that one program serves both.
    """
    traces = []

    def counted(*args):
        traces.append(1)
        return case.fn(*args)

    compiled = optimised(counted)  # reassociation is part of what is tested
    points = [cast(args, jnp.float64) for args in case.points]
    expected = [compiled(*args) for args in points]
    close(case.fn(*points[-1]), expected[-1], 1e-12)
    looped = expected + [compiled(*(a * (1.0 + 1e-4) for a in args)) for args in points]
    assert len(traces) == 1
    stacked = [tuple(np.stack(leaves) for leaves in zip(*case.points))]
    stacked += [tuple(a * (1.0 + 1e-4) for a in stacked[0]), *map(shifted, case.points)]
    batch = quick(jax.vmap(case.fn))(*cast(map(np.concatenate, zip(*stacked)), jnp.float64))
    for i, out in enumerate(looped):
        close(jax.tree.map(lambda leaf, i=i: leaf[i], batch), out, 1e-12)

    numbers = np.concatenate([np.reshape(leaf, (len(leaf), -1)) for leaf in jax.tree.leaves(batch)], axis=1)
    moved = np.split(numbers[len(looped) :], 2 * len(points))
    gradient = quick(pulled(case.fn))
    for args, wide, plus, minus in zip(case.points, expected, moved[::2], moved[1::2]):
        narrow = compiled(*cast(args, jnp.float32))
        assert {leaf.dtype for leaf in jax.tree.leaves(wide)} == {jnp.dtype("float64")}
        assert {leaf.dtype for leaf in jax.tree.leaves(narrow)} == {jnp.dtype("float32")}
        close(narrow, wide, case.rtol32)

        difference = (plus - minus).T / (2 * STEP)
        size, noise = np.max(np.abs(difference)), 1e-10 * np.max(np.abs(plus))
        wide, narrow = (
            np.stack([gradient(cast(args, dtype), row) for row in np.eye(len(difference), dtype=dtype)])
            for dtype in (jnp.float64, jnp.float32)
        )
        assert (wide.dtype, narrow.dtype) == (np.float64, np.float32)
        scales = sizes(args)
        np.testing.assert_allclose(wide * scales, difference, rtol=0, atol=1e-6 * size + noise)
        np.testing.assert_allclose(narrow * scales, wide * scales, rtol=0, atol=case.gradient_rtol32 * size + 1e-300)
    assert len(traces) == 2


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_strict_flags(case, jax_flags):
    """Values and derivatives under all of JAX's strictness flags at once."""
    args = cast(case.points[0], jnp.float32)
    with jax_flags(strict=True):
        out = jax.eval_shape(lambda *args: jax.jvp(case.fn, args, args), *args)
    assert {leaf.dtype for leaf in jax.tree.leaves(out)} == {jnp.dtype("float32")}


GUARDED = ("quat_normalize", "quat_to_rotation_vector", "quat_from_rotation_vector", "illumination_conical", "stm_hcw")


@pytest.mark.parametrize("name", GUARDED)
def test_no_number_on_the_way_is_nan_or_infinite(name, jax_flags):
    """Operation by operation, on both sides of each branch, as the search for NaN looks at them."""
    case = next(case for case in CASES if case.name == name)
    with jax_flags(debug_nans=True, debug_infs=True):
        for args in case.points:
            case.fn(*cast(args, jnp.float32))


def test_epochs_of_mixed_types_under_strict_flags(jax_flags):
    """A whole day beside float seconds is no mixture that the caller has to resolve."""
    with jax_flags(strict=True):
        for day in (61253, np.int32(61253), jnp.asarray(61253, jnp.int32)):
            assert time.gmst(day, jnp.float32(43210.0)).dtype == jnp.float32
            world = forces.environment_at({"sun", "moon", "rotation"}, day, jnp.float32(43210.0))
            assert {leaf.dtype for leaf in jax.tree.leaves(world)} == {jnp.dtype("float32")}


def test_readme_under_strict_flags(jax_flags, capsys):
    text = (pathlib.Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1)
    with jax_flags(strict=True, debug_nans=True, debug_infs=True, check_tracer_leaks=True):
        exec(compile(block, "README.md", "exec"), {})
    assert "e+" in capsys.readouterr().out


def test_every_public_function_has_a_case():
    covered = {case.name.split("/")[0] for case in CASES} | NOT_PHYSICS
    modules = [getattr(astrojax, name) for name in astrojax.__all__]
    modules += [astrojax.forces.atmosphere, astrojax.orbits.sgp4]
    names = {
        name
        for module in modules
        for name, value in vars(module).items()
        if inspect.isfunction(value) and not name.startswith("_") and value.__module__.startswith(module.__name__)
    }
    assert len(names) > 35
    assert names <= covered


@pytest.mark.parametrize("name", ["moon_position", "ForceModel.accel", "quat_angle"])
def test_float32_without_x64(name):
    """JAX's default configuration runs them too."""
    case = next(case for case in CASES if case.name == name)
    out = jax.jit(case.fn)(*cast(case.points[0], jnp.float32))
    assert out.dtype == jnp.float32
    assert np.all(np.isfinite(out))
