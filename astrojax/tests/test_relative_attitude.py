"""Relative motion against brahe and SciPy; attitude against SciPy and closed forms."""

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from astrojax import attitude, forces, frames, orbits, propagate

CHIEF = np.asarray([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])
DEPUTY = CHIEF + np.array([120.0, -80.0, 40.0, 0.3, -0.2, 0.1])
N = 1.13e-3


# --- relative motion ---


def test_rtn_against_brahe(x64):
    """Rotation to 1e-14, relative state to 1 nm and 1e-12 m/s, and back to 1 nm."""
    chief, deputy = jnp.asarray(CHIEF), jnp.asarray(DEPUTY)
    np.testing.assert_allclose(frames.rotation_eci_to_rtn(chief), brahe.rotation_eci_to_rtn(CHIEF), atol=1e-14)
    rel = frames.state_eci_to_rtn(chief, deputy)
    theirs = np.asarray(brahe.state_eci_to_rtn(CHIEF, DEPUTY))
    np.testing.assert_allclose(rel[:3], theirs[:3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(rel[3:], theirs[3:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(frames.state_rtn_to_eci(chief, rel), DEPUTY, rtol=0, atol=2e-9)
    accel = jnp.asarray([0.1, -0.3, 0.2])
    there = frames.state_eci_to_rtn(chief, deputy, accel)
    np.testing.assert_allclose(frames.state_rtn_to_eci(chief, there, accel), DEPUTY, rtol=0, atol=2e-9)


def accel_thrusting(r):
    return forces.accel_two_body(r) + forces.accel_zonal(r, 6) + jnp.asarray([0.3, -0.5, 0.4])


def test_rtn_rate_is_the_rate_of_the_axes(x64):
    """omega x = C dC^T/dt along a thrusting orbit, out-of-plane turning included, to 1e-12 rad/s."""
    chief = jnp.asarray(CHIEF)
    accel = accel_thrusting(chief[:3])
    matrix, matrix_dot = jax.jvp(frames.rotation_eci_to_rtn, (chief,), (jnp.concatenate([chief[3:], accel]),))
    skew = matrix @ matrix_dot.T
    omega = frames.rtn_rate(chief, accel)
    np.testing.assert_allclose(omega, [skew[2, 1], skew[0, 2], skew[1, 0]], rtol=0, atol=1e-15)
    assert abs(float(omega[0])) > 1e-5  # the term under test is not negligible here


def test_rtn_velocity_is_the_derivative_of_rtn_position(x64):
    """With the chief's acceleration, relative velocity is the rate of relative position, to 1e-10 m/s."""

    def position(chief, deputy):
        return frames.state_eci_to_rtn(chief, deputy)[:3]

    states = tuple(jnp.asarray(s) for s in (CHIEF, DEPUTY))
    rates = tuple(jnp.concatenate([s[3:], accel_thrusting(s[:3])]) for s in states)
    _, velocity = jax.jvp(position, states, rates)
    rel = frames.state_eci_to_rtn(*states, rates[0][3:])
    np.testing.assert_allclose(rel[3:], velocity, rtol=0, atol=1e-10)


def hcw_matrix(n):
    m = np.zeros((6, 6))
    m[:3, 3:] = np.eye(3)
    m[3, [0, 4]] = 3 * n * n, 2 * n
    m[4, 3] = -2 * n
    m[5, 2] = -n * n
    return m


@pytest.mark.parametrize("dt", [0.05, 100.0, 442.0, 443.0, 5560.0, -300.0])
def test_hcw_transition_against_matrix_exponential(dt, x64):
    """Relative to 100 m and 0.1 m/s starts: within 1 um and 1 nm/s, an orbit included."""
    ours = np.asarray(orbits.stm_hcw(N, dt)) @ np.diag([100, 100, 100, 0.1, 0.1, 0.1])
    theirs = scipy.linalg.expm(hcw_matrix(N) * dt) @ np.diag([100, 100, 100, 0.1, 0.1, 0.1])
    np.testing.assert_allclose(ours[:3], theirs[:3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(ours[3:], theirs[3:], rtol=0, atol=1e-9)


def test_hcw_acceleration_against_matrix(rng, x64):
    for state in rng.normal(size=(5, 6)) * [100, 100, 100, 0.1, 0.1, 0.1]:
        ours = orbits.accel_hcw(jnp.asarray(state), N)
        np.testing.assert_allclose(ours, hcw_matrix(N)[3:] @ state, rtol=0, atol=1e-18)


def test_hcw_without_rotation_is_free_drift(quick, x64):
    matrix = orbits.stm_hcw(0.0, 7.0)
    np.testing.assert_array_equal(matrix, np.block([[np.eye(3), 7 * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]]))
    assert np.all(np.isfinite(quick(jax.jacrev(orbits.stm_hcw))(0.0, 7.0)))


def test_hcw_describes_nearby_orbits(x64):
    """A deputy 100 m away on a two-body orbit stays within 5 cm of HCW for ten minutes."""
    oe = jnp.asarray([6795e3, 0.0, 0.9, 0.3, 0.0, 0.2])
    n = orbits.mean_motion(oe[0])
    rel = jnp.asarray([60.0, -70.0, 40.0, 0.05, -0.1, 0.02])
    deputy = orbits.cartesian_to_keplerian(frames.state_rtn_to_eci(orbits.keplerian_to_cartesian(oe), rel))
    after = [orbits.keplerian_to_cartesian(orbits.propagate_keplerian(x, 600.0)) for x in (oe, deputy)]
    exact = frames.state_eci_to_rtn(*after)
    np.testing.assert_allclose(orbits.stm_hcw(n, 600.0) @ rel, exact, rtol=0, atol=0.05)


# --- attitude ---


def scipy_rotation(q):
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


@pytest.fixture
def quaternions(rng):
    q = rng.normal(size=(200, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_quaternions_against_scipy(quaternions, rng, x64):
    """Product, rotation and matrix to 1e-14."""
    p, q = quaternions[:100], quaternions[100:]
    v = rng.normal(size=(100, 3))
    np.testing.assert_allclose(
        jax.vmap(lambda a, b: attitude.quat_to_rotation(attitude.quat_multiply(a, b)))(p, q),
        (scipy_rotation(p) * scipy_rotation(q)).as_matrix(),
        atol=1e-14,
    )
    np.testing.assert_allclose(jax.vmap(attitude.quat_rotate)(q, v), scipy_rotation(q).apply(v), atol=1e-14)
    conjugate = jax.vmap(attitude.quat_conjugate)(q)
    np.testing.assert_allclose(
        jax.vmap(attitude.quat_rotate)(conjugate, v), scipy_rotation(q).inv().apply(v), atol=1e-14
    )


def test_rotation_to_quat_all_branches(quaternions, x64):
    """The same rotation back to 1e-14, whichever component is largest; exact half turns included."""
    half_turns = np.eye(4)[1:]
    q = np.concatenate([quaternions, half_turns, [[0, np.sqrt(0.5), -np.sqrt(0.5), 0]]])
    assert set(np.argmax(np.abs(q), axis=1)) == {0, 1, 2, 3}
    back = jax.jit(jax.vmap(attitude.rotation_to_quat))(jnp.asarray(scipy_rotation(q).as_matrix()))
    np.testing.assert_allclose(np.abs(np.sum(back * q, axis=1)), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(scipy_rotation(back).as_matrix(), scipy_rotation(q).as_matrix(), atol=1e-14)
    assert np.all(np.max(back, axis=1) >= 0.5)


def test_rotation_vectors_against_scipy(quaternions, x64):
    """To 1e-13 rad, both ways; the same for q and -q."""
    expected = scipy_rotation(quaternions).as_rotvec()
    to_vector = jax.jit(jax.vmap(attitude.quat_to_rotation_vector))
    for q in (quaternions, -quaternions, 2.5 * quaternions):
        np.testing.assert_allclose(to_vector(jnp.asarray(q)), expected, rtol=0, atol=1e-13)
    back = jax.vmap(attitude.quat_from_rotation_vector)(jnp.asarray(expected))
    np.testing.assert_allclose(scipy_rotation(back).as_matrix(), scipy_rotation(quaternions).as_matrix(), atol=1e-13)


@pytest.mark.parametrize("dtype, tolerance", [("float64", 1e-14), ("float32", 5e-7)])
def test_rotation_vector_round_trip_over_all_angles(dtype, tolerance, quick, x64):
    """Tiny to nearly half a turn: error relative to the angle (above 1 urad)."""
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    angles = np.concatenate([[0.0], np.logspace(-12, -1, 45), np.linspace(0.1, np.pi - 1e-3, 20)])
    phi = jnp.asarray(angles[:, None] * axis, dtype)
    back = quick(jax.vmap(lambda p: attitude.quat_to_rotation_vector(attitude.quat_from_rotation_vector(p))))(phi)
    assert back.dtype == dtype
    error = np.linalg.norm(np.asarray(back - phi, float), axis=1)
    assert np.max(error / np.maximum(angles, 1e-6)) < tolerance


def test_angle_against_scipy(quaternions, x64):
    """Total angle to 1e-14 rad, sign-invariant, accurate down to a nanoradian; zero gradient at equality."""
    p, q = quaternions[:100], quaternions[100:]
    expected = (scipy_rotation(p).inv() * scipy_rotation(q)).magnitude()
    angle = jax.vmap(attitude.quat_angle)
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(angle(jnp.asarray(p), jnp.asarray(sign * q)), expected, rtol=0, atol=1e-14)
    tiny = attitude.quat_from_rotation_vector(jnp.asarray([0.0, 1e-9, 0.0]))
    start = jnp.asarray(p[0])
    assert float(attitude.quat_angle(start, attitude.quat_multiply(start, tiny))) == pytest.approx(1e-9, abs=1e-15)
    np.testing.assert_allclose(jax.grad(attitude.quat_angle)(start, start), 0.0, atol=1e-12)


def test_gradients_at_singular_quaternions(quick, x64):
    """Identity, half turn, full turn and the zero quaternion: values and gradients finite."""
    q = jnp.asarray([[1.0, 0, 0, 0], [0.0, 1, 0, 0], [-1.0, 0, 0, 0], [0.0, 0, 0, 0]])
    for fn in (attitude.quat_normalize, attitude.quat_to_rotation_vector):
        values, gradients = quick(jax.vmap(lambda q, fn=fn: (fn(q), jax.jacrev(fn)(q))))(q)
        assert np.all(np.isfinite(values)), fn.__name__
        assert np.all(np.isfinite(gradients)), fn.__name__
    gradients = quick(jax.vmap(jax.grad(attitude.quat_angle), in_axes=(0, None)))(q[:3], q[0])
    assert np.all(np.isfinite(gradients))


def test_kinematics_of_a_constant_rate(x64):
    """q(t) = q0 * exp(omega t / 2) for a constant body rate: RK4 at 1 Hz within 1e-8 after 100 s."""
    omega = jnp.asarray([0.01, -0.02, 0.015])
    q = start = jnp.asarray([0.5, 0.5, -0.5, 0.5])
    for _ in range(100):
        q = propagate.rk4_step(lambda t, q: attitude.quat_derivative(q, omega), 0.0, q, 1.0)
    exact = attitude.quat_multiply(start, attitude.quat_from_rotation_vector(100.0 * omega))
    np.testing.assert_allclose(q, exact, rtol=0, atol=1e-8)


INERTIA = np.array([[8.0e4, 300.0, -200.0], [300.0, 8.1e4, 500.0], [-200.0, 500.0, 5.0e4]])


def test_euler_against_linear_solve(rng, x64):
    """Within 1e-14 relative of a dense solve, for an inertia with products."""
    for omega, torque in rng.normal(size=(5, 2, 3)):
        ours = attitude.accel_euler(jnp.asarray(omega), jnp.asarray(INERTIA), jnp.asarray(1e3 * torque))
        exact = np.linalg.solve(INERTIA, 1e3 * torque - np.cross(omega, INERTIA @ omega))
        np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-13 * np.linalg.norm(exact))


def test_torque_free_tumbling_conserves_momentum_and_energy(x64):
    """Inertial momentum and energy to 5e-9 over 200 s, and the symmetric top's precession."""
    inertia = jnp.asarray(np.diag([8e4, 8e4, 5e4]))
    zero = jnp.zeros(3)

    def f(t, y):
        return attitude.quat_derivative(y[0], y[1]), attitude.accel_euler(y[1], inertia, zero)

    y = start = (jnp.asarray([1.0, 0.0, 0.0, 0.0]), jnp.asarray([0.03, 0.0, 0.08]))
    step = jax.jit(lambda y: propagate.rk4_step(f, 0.0, y, 0.5))
    for _ in range(400):
        y = step(y)

    def invariants(y):
        return attitude.quat_rotate(y[0], inertia @ y[1]), 0.5 * y[1] @ inertia @ y[1]

    for now, then in zip(invariants(y), invariants(start)):
        np.testing.assert_allclose(now, then, rtol=0, atol=5e-9 * np.max(np.abs(then)))
    precession = (5e4 - 8e4) / 8e4 * 0.08 * 200.0
    np.testing.assert_allclose(y[1], [0.03 * np.cos(precession), 0.03 * np.sin(precession), 0.08], rtol=0, atol=1e-9)


def test_gravity_gradient_against_point_masses(x64):
    """Equal to the summed pull on six point masses of 1 m arms, to its next order (1e-6 relative)."""
    arms = np.array([[1.0, 0.3, 0.0], [0.2, 1.2, 0.1], [0.0, -0.1, 0.7]])
    points, mass = np.concatenate([arms, -arms]) * 30.0, 50.0
    inertia = mass * sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
    r = np.array([4e6, -3e6, 4.5e6])
    pulls = np.array(
        [forces.accel_two_body(jnp.asarray(r + p)) - forces.accel_two_body(jnp.asarray(r)) for p in points]
    )
    exact = mass * np.sum(np.cross(points, pulls), axis=0)
    ours = attitude.torque_gravity_gradient(jnp.asarray(r), jnp.asarray(inertia))
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-6 * np.linalg.norm(exact))


def test_quat_sign_brings_a_quaternion_to_the_side_of_another():
    rng = np.random.default_rng(3)
    q, reference = rng.normal(size=(2, 50, 4))
    for array in (np.asarray, jnp.asarray):
        sign = attitude.quat_sign(array(q), array(reference))
        assert sign.dtype == array(q).dtype
        assert set(np.asarray(sign).tolist()) == {-1.0, 1.0}
        assert (np.sum(sign[:, None] * q * reference, axis=1) >= 0).all()
    assert attitude.quat_sign(q[0], np.zeros(4)) == 1.0  # across: either side will do, and it is kept
