"""The adaptive integrators against closed forms and SciPy: error, order, dense output, events, derivatives, status."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from astrojax import orbits, propagate
from astrojax.constants import GM_EARTH

METHODS = (propagate.DORMAND_PRINCE, propagate.FEHLBERG, propagate.NYSTROM_12)
ELEMENTS = np.array([8e6, 0.1, 0.9, 1.0, 0.4, 0.2])
PERIOD = 2 * np.pi * np.sqrt(ELEMENTS[0] ** 3 / GM_EARTH)


def two_body(t, y, gm=GM_EARTH):
    del t
    r = y[:3]
    return jnp.concatenate([y[3:], -gm * r / (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) ** 1.5])


def kepler(t):
    return orbits.keplerian_to_cartesian(orbits.propagate_keplerian(jnp.asarray(ELEMENTS), t))


def energy(y):
    return 0.5 * np.sum(y[3:] ** 2) - GM_EARTH / np.linalg.norm(y[:3])


def _named(value):
    """A method by its name: its functions have addresses, which differ between processes."""
    return getattr(value, "name", str(value))


@pytest.mark.parametrize(("method", "within"), zip(METHODS, (6e-3, 2e-2, 3e-6), strict=True), ids=_named)
def test_three_orbits_and_back(method, within, quick, x64):
    """Against Kepler's equation [m], and the start again; energy is kept to the tolerance."""
    solve = quick(functools.partial(propagate.integrate, two_body, method=method, rtol=1e-11, atol=1e-9))
    there = solve(0.0, kepler(0.0), 3 * PERIOD)
    assert there.status == propagate.SUCCESS
    assert there.t == 3 * PERIOD
    assert np.linalg.norm((there.y - kepler(3 * PERIOD))[:3]) < within
    assert abs(energy(np.asarray(there.y)) / energy(np.asarray(kepler(0.0))) - 1) < 1e-10
    back = solve(3 * PERIOD, there.y, 0.0)
    assert back.t == 0
    assert np.linalg.norm((back.y - kepler(0.0))[:3]) < 3 * within


@pytest.mark.parametrize(
    ("method", "order", "steps"), zip(METHODS, (5, 5, 12), ((64, 128), (64, 128), (6, 9)), strict=True), ids=_named
)
def test_order_of_convergence(method, order, steps, quick, x64):
    """Errors of equal steps fall as the power that the method is named after."""

    def error(n):
        h = PERIOD / n
        found = propagate.integrate(
            two_body, 0.0, kepler(0.0), PERIOD, method=method, rtol=1e6, first_step=h, max_step=h
        )
        assert found.steps in (n, n + 1)
        return np.linalg.norm((found.y - kepler(0.0))[:3])

    few, many = (error(n) for n in steps)
    measured = np.log(few / many) / np.log(steps[1] / steps[0])
    assert measured == pytest.approx(order, abs=0.15 * order)


def test_conditions_of_the_nystrom_method():
    """The quadrature conditions of order 12, and the rows' own."""
    from astrojax.propagate import nystrom as n

    c = n._NODES
    for k in range(12):
        assert np.sum(n._VELOCITY * c**k) == pytest.approx(1 / (k + 1), abs=1e-14)
    for k in range(11):
        assert np.sum(n._POSITION * c**k) == pytest.approx(1 / ((k + 1) * (k + 2)), abs=1e-14)
    for i, row in enumerate(n._MATRIX[1:], 2):
        for k in range(5 if i > 9 else 1):
            assert np.sum(row * c[: len(row)] ** k) == pytest.approx(c[i] ** (k + 2) / ((k + 1) * (k + 2)), abs=1e-14)


def test_against_scipy(quick, x64):
    """The same equations, at tolerances where both are exact; and about as many steps at equal ones."""

    def f(t, y, k):
        return {"x": y["v"], "v": -k * y["x"] - 0.1 * y["v"] + jnp.cos(3 * t)}

    start = {"x": jnp.array([1.0, 2.0]), "v": jnp.array([0.0, -1.0])}
    found = quick(functools.partial(propagate.integrate, f, rtol=1e-11, atol=1e-12))(0.0, start, 20.0, 4.0)

    def g(t, y):
        return np.concatenate([y[2:], -4.0 * y[:2] - 0.1 * y[2:] + np.cos(3 * t)])

    theirs = solve_ivp(g, (0, 20), [1.0, 2.0, 0.0, -1.0], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(np.concatenate([found.y["x"], found.y["v"]]), theirs, rtol=0, atol=1e-9)
    rk45 = solve_ivp(g, (0, 20), [1.0, 2.0, 0.0, -1.0], method="RK45", rtol=1e-11, atol=1e-12)
    assert int(found.steps) < 1.2 * (len(rk45.t) - 1)


def test_dense_output(quick, x64):
    """Between steps as good as the steps themselves, and it says what it does not cover."""
    path = quick(functools.partial(propagate.trajectory, two_body, rtol=1e-9, atol=1e-6))(0.0, kepler(0.0), PERIOD)
    assert path.status == propagate.SUCCESS
    times = np.linspace(0, PERIOD, 301)
    found, inside = quick(jax.vmap(propagate.interpolate, (None, 0)))(path, jnp.asarray(times))
    assert np.all(inside)
    apart = np.linalg.norm((found - jax.vmap(kepler)(jnp.asarray(times)))[:, :3], axis=1)
    assert np.max(apart) < 0.1
    outside, inside = propagate.interpolate(path, -1.0)
    assert not inside
    np.testing.assert_allclose(outside, path.y[0])
    back = propagate.trajectory(two_body, PERIOD, path.y[-1], 0.0, rtol=1e-9, atol=1e-6)
    found, inside = propagate.interpolate(back, 1234.5)
    assert inside
    assert np.linalg.norm((found - kepler(1234.5))[:3]) < 0.2


def test_events_of_an_orbit(quick, x64):
    """Nodes and apsides where Kepler's equation has them, to a microsecond; altitude rises and falls between."""

    def fly(t1):
        path = propagate.trajectory(two_body, 0.0, kepler(0.0), t1, rtol=1e-12, atol=1e-7, max_steps=2000)
        find = functools.partial(propagate.events, path, f=two_body)
        return (
            find(orbits.event_node, direction=1),
            find(orbits.event_node),
            find(orbits.event_apsis, direction=1),
            find(orbits.event_altitude(1.5e6), max_events=3),
        )

    up, nodes, perigees, heights = quick(fly)(2.2 * PERIOD)

    def time_of(true_anomaly):
        e = ELEMENTS[1]
        ecc = 2 * np.arctan2(np.sqrt(1 - e) * np.sin(true_anomaly / 2), np.sqrt(1 + e) * np.cos(true_anomaly / 2))
        return ((ecc - e * np.sin(ecc) - ELEMENTS[5]) / (2 * np.pi) % 1.0) * PERIOD

    argument = ELEMENTS[4]
    assert up.count == 2
    np.testing.assert_allclose(up.t[:2], time_of(-argument) + PERIOD * np.arange(2), rtol=0, atol=1e-6)
    assert nodes.count == 4
    np.testing.assert_allclose(nodes.t[0], time_of(np.pi - argument), rtol=0, atol=1e-6)
    assert np.all(np.abs(nodes.y[:4, 2]) < 1e-4)
    np.testing.assert_allclose(perigees.t[:2], time_of(0.0) + PERIOD * np.arange(2), rtol=0, atol=1e-6)
    assert perigees.found.tolist()[:3] == [True, True, False]
    assert heights.count == 5  # more than there was room for
    assert np.all(heights.found)
    np.testing.assert_allclose(np.linalg.norm(heights.y[:, :3], axis=1), 6378136.3 + 1.5e6, rtol=0, atol=1e-3)


def test_eclipse_of_a_circular_orbit(quick, x64):
    """In the plane of the Sun: its length is that of the shadow's cone."""
    radius, rate = 7e6, np.sqrt(GM_EARTH / 7e6**3)
    start = jnp.array([radius, 0.0, 0.0, 0.0, radius * rate, 0.0])
    sun = jnp.array([1.496e11, 0.0, 0.0])

    def fly(t1):
        path = propagate.trajectory(two_body, 0.0, start, t1, rtol=1e-11, atol=1e-6, max_steps=1000)
        shadow = functools.partial(orbits.event_eclipse, lambda t: sun)
        return tuple(propagate.events(path, shadow(umbra=u), two_body, max_events=3) for u in (False, True))

    penumbra, umbra = quick(fly)(2 * np.pi / rate)
    assert penumbra.count == umbra.count == 2
    for found, sign in ((penumbra, 1.0), (umbra, -1.0)):
        half = np.arcsin(6378136.3 / radius) + sign * 6.957e8 / 1.496e11
        np.testing.assert_allclose(found.t[:2], (np.pi + half * np.array([-1, 1])) / rate, rtol=0, atol=0.05)


def test_state_transition_matrix(quick, x64):
    """Against central differences of Kepler's orbit; symplectic, as gravity's must be."""
    solve = functools.partial(propagate.state_transition_matrix, two_body, method=propagate.NYSTROM_12, rtol=1e-12)
    _, matrix = quick(lambda y: solve(0.0, y, 0.7 * PERIOD))(kepler(0.0))
    scale = np.diag([1e7] * 3 + [1e4] * 3)
    unitless = np.linalg.inv(scale) @ np.asarray(matrix) @ scale
    j = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    np.testing.assert_allclose(unitless.T @ j @ unitless, j, rtol=0, atol=1e-8)

    def moved(i, h):
        y = kepler(0.0).at[i].add(h)
        return orbits.keplerian_to_cartesian(orbits.propagate_keplerian(orbits.cartesian_to_keplerian(y), 0.7 * PERIOD))

    for i, h in ((0, 50.0), (4, 0.05)):
        difference = (moved(i, h) - moved(i, -h)) / (2 * h)
        np.testing.assert_allclose(matrix[:, i], difference, rtol=1e-5, atol=1e-5 * np.max(np.abs(difference)))


def test_reverse_mode_agrees_with_forward_mode(quick, x64):
    """By state, parameter and both times."""
    y, options = kepler(0.0), {"rtol": 1e-9, "atol": 1e-6}

    def forward(t0, t1, y, gm):
        return propagate.integrate(two_body, t0, y, t1, gm, **options).y[0]

    args = jnp.asarray(0.0), jnp.asarray(2000.0), y, jnp.asarray(GM_EARTH)
    t0, t1, by_y, by_gm = quick(jax.jacfwd(forward, argnums=(0, 1, 2, 3)))(*args)

    def reverse(t0, t1, y, gm):
        solution, back = propagate.pullback(two_body, t0, y, t1, gm, max_steps=96, **options)
        return solution, back(jnp.zeros(6).at[0].set(1.0))

    solution, (u0, uy, u1, ugm) = quick(reverse)(*args)
    assert solution.status == propagate.SUCCESS
    for a, b in ((t0, u0), (t1, u1), (by_y, uy), (by_gm, ugm)):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.max(np.abs(a)))
    np.testing.assert_allclose(t1, solution.y[3], rtol=1e-6)


def test_what_goes_wrong_is_a_status(quick, x64):
    def wall(t, y):
        return jnp.where(t < 0.5, y, jnp.nan)

    def pole(t, y):
        return y * y

    found = propagate.integrate(wall, 0.0, jnp.ones(1), 1.0)
    assert found.status == propagate.NOT_FINITE
    assert 0.4 < found.t <= 0.5
    found = propagate.integrate(pole, 0.0, jnp.ones(1), 2.0)
    assert found.status == propagate.STEP_TOO_SMALL
    assert found.t == pytest.approx(1.0, abs=1e-6)
    assert np.all(np.isfinite(found.y))
    found = propagate.integrate(two_body, 0.0, kepler(0.0), PERIOD, rtol=1e-12, max_steps=10)
    assert found.status == propagate.TOO_MANY_STEPS
    assert 0 < found.t < PERIOD
    assert propagate.trajectory(two_body, 0.0, kepler(0.0), PERIOD, max_steps=10).status == propagate.TOO_MANY_STEPS
    assert propagate.integrate(two_body, 5.0, kepler(0.0), 5.0).status == propagate.SUCCESS


def test_a_batch_takes_each_its_own_steps(quick, x64):
    """And tolerances are traced: none of them compiles anew."""
    traces = []

    def solve(y, rtol):
        traces.append(1)
        return propagate.integrate(two_body, 0.0, y, 3000.0, rtol=rtol, atol=1e-3)

    compiled = quick(jax.vmap(solve))
    batch = jnp.stack([kepler(0.0), kepler(500.0), kepler(900.0)])
    found = compiled(batch, jnp.array([1e-6, 1e-8, 1e-10]))
    compiled(batch, jnp.array([1e-7, 1e-8, 1e-9]))
    assert len(traces) == 1
    assert np.all(np.diff(found.steps) > 0)
    alone = propagate.integrate(two_body, 0.0, batch[2], 3000.0, rtol=1e-10, atol=1e-3)
    assert alone.steps == found.steps[2]
    np.testing.assert_allclose(found.y[2], alone.y, rtol=1e-12)


def test_single_precision(quick):
    start = np.asarray([7e6, 0.0, 0.0, 0.0, 7546.0, 0.0], np.float32)
    found = quick(functools.partial(propagate.integrate, two_body, rtol=1e-6, atol=1e-3))(0.0, start, 3000.0)
    assert found.y.dtype == jnp.float32
    assert found.status == propagate.SUCCESS
    with jax.enable_x64(True):
        wide = propagate.integrate(two_body, 0.0, jnp.asarray(start, jnp.float64), 3000.0)
    assert np.linalg.norm((np.asarray(found.y) - np.asarray(wide.y))[:3]) < 100.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"max_steps": 0}, "max_steps: expected at least 1, got 0"),
        ({"method": propagate.NYSTROM_12, "y0": np.ones(3)}, "as many velocities as positions, got 3"),
        ({"y0": np.ones(2, int)}, "y0: expected floating-point"),
    ],
)
def test_mistakes_are_named(arguments, message):
    arguments = {"y0": np.ones(2), **arguments}
    with pytest.raises(ValueError, match=message):
        propagate.integrate(lambda t, y: y, 0.0, t1=1.0, **arguments)


def test_mistakes_about_events_are_named(x64):
    path = propagate.trajectory(two_body, 0.0, kepler(0.0), 100.0, max_steps=4)
    with pytest.raises(ValueError, match="direction: expected -1, 0 or 1, got 2"):
        propagate.events(path, orbits.event_node, two_body, direction=2)
    with pytest.raises(ValueError, match="samples, max_events: expected at least 1, got 0 and 8"):
        propagate.events(path, orbits.event_node, two_body, samples=0)
