"""Matrices, axis and angle, the twelve Euler sequences and modified Rodrigues parameters, against SciPy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from astrojax import attitude
from astrojax.attitude import SEQUENCES

scalar_last = [1, 2, 3, 0]


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_sequences(sequence, rng, quick, x64):
    angles = rng.uniform(-np.pi, np.pi, (100, 3))
    angles[:, 1] = rng.uniform(0.0, np.pi, 100) - (0.0 if sequence[0] == sequence[2] else np.pi / 2)
    reference = Rotation.from_euler(sequence, angles)
    matrix, q, back, omega, rates = quick(
        jax.vmap(
            lambda a, w: (
                attitude.euler_to_rotation(a, sequence),
                attitude.euler_to_quat(a, sequence),
                attitude.rotation_to_euler(attitude.euler_to_rotation(a, sequence), sequence),
                attitude.euler_rates_to_omega(a, w, sequence),
                attitude.euler_derivative(a, attitude.euler_rates_to_omega(a, w, sequence), sequence),
            )
        )
    )(angles, w := rng.normal(size=(100, 3)))
    np.testing.assert_allclose(matrix, reference.as_matrix(), rtol=0, atol=2e-15)
    np.testing.assert_allclose(np.abs(np.sum(q[:, scalar_last] * reference.as_quat(), axis=1)), 1.0, atol=1e-15)
    np.testing.assert_allclose(back, angles, rtol=0, atol=1e-13)
    np.testing.assert_allclose(rates, w, rtol=0, atol=1e-11)
    # Body rates: R^T dR/dt is the skew matrix of them.
    h = 1e-6
    plus, minus = (Rotation.from_euler(sequence, angles + s * h * w).as_matrix() for s in (1, -1))
    spin = np.swapaxes(reference.as_matrix(), 1, 2) @ (plus - minus) / (2 * h)
    np.testing.assert_allclose(omega, np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], 1), rtol=0, atol=1e-8)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_euler_singularities(sequence, quick, x64):
    """The third angle is zero, the rotation is kept, and gradients are finite."""
    middles = (0.0, np.pi) if sequence[0] == sequence[2] else (np.pi / 2, -np.pi / 2)
    angles = np.array([[0.7, middle, -0.4] for middle in middles])
    rotations = Rotation.from_euler(sequence, angles).as_matrix()
    rotations = np.where(np.abs(rotations) < 1e-15, 0.0, rotations)
    convert = functools.partial(attitude.rotation_to_euler, sequence=sequence)
    back, gradient = quick(jax.vmap(lambda m: (convert(m), jax.jacrev(convert)(m))))(rotations)
    assert not np.any(back[:, 2])
    np.testing.assert_allclose(Rotation.from_euler(sequence, np.asarray(back)).as_matrix(), rotations, atol=1e-14)
    assert np.all(np.isfinite(gradient))
    held = quick(jax.vmap(lambda a: attitude.euler_derivative(a, jnp.ones(3), sequence)))(angles)
    assert np.all(np.isfinite(held))


def test_unknown_sequence():
    with pytest.raises(ValueError, match=r"sequence: expected one of XYX, .*, got 'XXZ'"):
        attitude.euler_to_rotation(jnp.zeros(3), "XXZ")


def test_mrp_axis_angle_and_vectors_against_scipy(rng, quick, x64):
    reference = Rotation.random(200, rng=rng)
    q = np.roll(reference.as_quat(), 1, axis=1)
    mrp, matrix, shadow, axis, angle, phi, again, turned = quick(
        jax.vmap(
            lambda q: (
                s := attitude.quat_to_mrp(q),
                attitude.mrp_to_rotation(s),
                attitude.mrp_to_rotation(attitude.mrp_shadow(s)),
                *attitude.quat_to_axis_angle(q),
                p := attitude.rotation_to_rotation_vector(attitude.mrp_to_rotation(s)),
                attitude.rotation_from_rotation_vector(p),
                attitude.axis_angle_to_quat(*attitude.quat_to_axis_angle(q)),
            )
        )
    )(q)
    np.testing.assert_allclose(mrp, reference.as_mrp(), rtol=0, atol=1e-14)
    for found in (matrix, shadow, again):
        np.testing.assert_allclose(found, reference.as_matrix(), rtol=0, atol=1e-14)
    np.testing.assert_allclose(phi, reference.as_rotvec(), rtol=0, atol=1e-13)
    np.testing.assert_allclose(axis * angle[:, None], reference.as_rotvec(), rtol=0, atol=1e-13)
    np.testing.assert_allclose(np.abs(np.sum(turned * q, axis=1)), 1.0, rtol=0, atol=1e-14)


def test_identity_has_no_axis_and_zero_no_shadow(jax_flags):
    q = jnp.array([1.0, 0.0, 0.0, 0.0])
    with jax_flags(debug_nans=True, debug_infs=True):
        axis, angle = attitude.quat_to_axis_angle(q)
        assert angle == 0.0 and list(axis) == [1.0, 0.0, 0.0]
        assert np.all(np.isfinite(jax.jacrev(lambda q: attitude.quat_to_axis_angle(q)[0])(q)))
        assert np.all(np.isfinite(jax.jacrev(attitude.mrp_shadow)(jnp.zeros(3))))
        assert np.all(np.isfinite(jax.jacrev(attitude.mrp_switch)(jnp.zeros(3))))


def test_kinematics_of_all_sets_agree(rng, quick, x64):
    """Each set's derivative is what its conversion makes of the quaternion's."""
    q = np.roll(Rotation.random(50, rng=rng).as_quat(), 1, axis=1)
    q *= np.sign(q[:, :1])
    omega = rng.normal(size=(50, 3))

    def both(q, w):
        q_dot = attitude.quat_derivative(q, w)
        pairs = []
        for convert, derivative in [
            (attitude.quat_to_rotation, attitude.rotation_derivative),
            (attitude.quat_to_mrp, attitude.mrp_derivative),
            *(
                (
                    lambda q, s=s: attitude.rotation_to_euler(attitude.quat_to_rotation(q), s),
                    functools.partial(attitude.euler_derivative, sequence=s),
                )
                for s in ("ZYX", "ZXZ", "XZY")
            ),
        ]:
            value, rate = jax.jvp(convert, (q,), (q_dot,))
            pairs.append((rate, derivative(value, w)))
        return pairs

    for rate, derivative in quick(jax.vmap(both))(q, omega):
        np.testing.assert_allclose(derivative, rate, rtol=1e-9, atol=1e-11)


vectors = st.tuples(*(st.floats(-3.0, 3.0) for _ in range(3)))


@given(vectors, vectors)
@settings(max_examples=50, deadline=None)
def test_invariants(angles, mrp):
    """Rotations are orthonormal, a switched set is short and turns alike."""
    a, s = np.array(angles), np.array(mrp)
    with jax.enable_x64(True):
        matrix = np.asarray(_zyx(a))
        short, before, after = map(np.asarray, _switched(s))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=1e-15)
    assert np.linalg.norm(short) <= 1.0 + 1e-15
    np.testing.assert_allclose(before, after, rtol=0, atol=1e-14)


_zyx = jax.jit(lambda a: attitude.euler_to_rotation(a, "ZYX"))


@jax.jit
def _switched(s):
    short = attitude.mrp_switch(s)
    return short, attitude.mrp_to_rotation(s), attitude.mrp_to_rotation(short)
