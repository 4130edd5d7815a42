"""Forces as objects: their sum, what each needs, weights, and a force of one's own."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import constants, ephemeris, forces, orbits, propagate
from astrojax.forces import Drag, ForceModel, HarrisPriester, PointMass, Spacecraft, ThirdBody, Zonal

ISS = np.array([6795e3, 0.0005, np.radians(51.64), 0.7, 0.3, 1.9])
CRAFT = Spacecraft(12000.0, 50.0, 2.2)
FORCES = (PointMass(), Zonal(4), ThirdBody("sun"), ThirdBody("moon"), Drag(HarrisPriester()))


@pytest.fixture
def state(x64):
    return orbits.keplerian_to_cartesian(jnp.asarray(ISS))


def accel_of(model, state, world):
    return model.accel(0.0, state[:3], state[3:], CRAFT, world)


def test_a_model_is_the_sum_of_its_forces(state):
    model = ForceModel(FORCES)
    world = model.environment(61253, 0.0)
    bare = accel_of(ForceModel((PointMass(),)), state, world)
    np.testing.assert_array_equal(bare, forces.accel_two_body(state[:3]))
    sizes = {Zonal: (1e-3, 2e-2), "sun": (1e-8, 1e-6), "moon": (1e-7, 2e-6), Drag: (1e-7, 1e-5)}
    for force in FORCES[1:]:
        low, high = sizes[getattr(force, "body", type(force))]
        assert low < np.linalg.norm(accel_of(ForceModel((PointMass(), force)), state, world) - bare) < high
    total = sum(accel_of(ForceModel((force,)), state, world) for force in FORCES)
    np.testing.assert_allclose(accel_of(model, state, world), total, rtol=0, atol=1e-14)


def test_only_what_is_needed_is_computed(state):
    assert ForceModel((PointMass(), Zonal(4))).environment(61253, 0.0) == forces.Environment()
    world = ForceModel((PointMass(), Drag())).environment(61253, 0.0)
    assert world.sun is not None and world.moon is None and world.rotation is None
    world = ForceModel((PointMass(), Zonal(4, of_date=True))).environment(61253, 0.0)
    assert world.rotation.shape == (3, 3) and world.sun is None
    given = jnp.eye(3)
    assert ForceModel((Zonal(of_date=True),)).environment(61253, 0.0, rotation=given).rotation is given


def test_sweeping_which_forces_act_traces_once(state):
    world = ForceModel(FORCES).environment(61253, 0.0)
    traces = []

    @jax.jit
    def accel(model):
        traces.append(1)
        return accel_of(model, state, world)

    everything = accel_of(ForceModel(FORCES), state, world)
    np.testing.assert_allclose(accel(ForceModel(FORCES, jnp.ones(5))), everything, rtol=1e-15)
    for off in range(1, 5):
        rest = accel_of(ForceModel(FORCES[:off] + FORCES[off + 1 :]), state, world)
        np.testing.assert_allclose(accel(ForceModel(FORCES, jnp.ones(5).at[off].set(0))), rest, rtol=1e-15)
    other = ForceModel((PointMass(4e14), *FORCES[1:]), jnp.ones(5))
    assert np.abs(accel(other) - everything).max() > 1e-3
    assert len(traces) == 1
    masks = jnp.asarray(np.stack([np.ones(5), [1, 0, 0, 0, 0]]))
    swept = jax.vmap(lambda w: accel_of(ForceModel(FORCES, w), state, world))(masks)
    np.testing.assert_allclose(swept, [everything, forces.accel_two_body(state[:3])], rtol=1e-15)


def test_every_parameter_is_a_leaf():
    model = ForceModel((PointMass(), Zonal(3), ThirdBody("moon"), Drag(HarrisPriester(4.0))))
    leaves = jax.tree.leaves(model)
    for number in (constants.GM_EARTH, constants.R_EARTH, constants.J3, constants.GM_MOON, 4.0):
        assert number in leaves
    again = jax.tree.map(lambda x: x, model)
    assert jax.tree.structure(again) == jax.tree.structure(model)
    assert jax.tree.map(lambda x: None, model).forces[2].gm is None


def test_the_environment_of_each_stage(state):
    """A function of t in place of the environment: the Sun moves on within a step."""
    model = ForceModel(FORCES)
    held = propagate.rk4_step(model.derivative, 0.0, state, 60.0, CRAFT, model.environment(61253, 30.0))
    moving = propagate.rk4_step(model.derivative, 0.0, state, 60.0, CRAFT, functools.partial(model.environment, 61253))
    assert 0 < np.abs(held - moving).max() < 1e-5


def test_pole_of_date(state):
    """A tilted figure axis is that of the rotated problem; a turn about the axis changes nothing."""
    angle = jnp.asarray(0.0026)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    tilt = jnp.asarray([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    spin = forces.earth_rotation(61253, 4321.0)
    world = forces.environment_at({"sun"}, 61253, 0.0, rotation=spin @ tilt)
    for force, fixed in ((Zonal(5, of_date=True), Zonal(5)), (Drag(of_date=True), Drag())):
        ours = force.accel(0.0, state[:3], state[3:], CRAFT, world)
        turned = world._replace(sun=tilt @ world.sun)
        expected = tilt.T @ fixed.accel(0.0, tilt @ state[:3], tilt @ state[3:], CRAFT, turned)
        np.testing.assert_allclose(ours, expected, rtol=1e-11)
        plain = fixed.accel(0.0, state[:3], state[3:], CRAFT, world)
        assert np.linalg.norm(ours - plain) > 1e-5 * np.linalg.norm(plain)
    expected = Zonal(5).accel(0.0, state[:3], state[3:], CRAFT, world)
    untilted = Zonal(5, of_date=True).accel(0.0, state[:3], state[3:], CRAFT, world._replace(rotation=spin))
    np.testing.assert_allclose(untilted, expected, rtol=0, atol=1e-16)


def test_earth_rotation_against_erfa(x64):
    """The Earth rotation angle to 1e-12 rad, 1990 to 2050."""
    erfa = pytest.importorskip("erfa")
    for day in (47892, 51544, 61253, 69807):
        ours = forces.earth_rotation(day, 43210.0)
        era = erfa.era00(2400000.5 + day, 43210.0 / 86400)
        np.testing.assert_allclose(ours, erfa.rz(era, np.eye(3)), rtol=0, atol=1e-11)


class Thruster:
    """A force of one's own: constant thrust along the velocity; no pytree, no base class, no line elsewhere."""

    needs = frozenset()

    def __init__(self, newtons):
        self.newtons = newtons

    def accel(self, t, r, v, spacecraft, environment):
        return self.newtons / spacecraft.required("mass", "Thruster") * v / jnp.sqrt(v @ v)


def test_a_force_of_ones_own(state):
    assert isinstance(Thruster(1.0), forces.Force)
    model = ForceModel((PointMass(), Thruster(600.0)))
    world = model.environment(61253, 0.0)
    extra = accel_of(model, state, world) - forces.accel_two_body(state[:3])
    np.testing.assert_allclose(np.linalg.norm(extra), 0.05, rtol=1e-10)
    apart = jnp.asarray([100.0, 50.0, -20.0]), jnp.asarray([0.1, 0.2, 0.3])
    light = CRAFT._replace(mass=6000.0)
    relative = model.relative(0.0, state[:3], state[3:], *apart, CRAFT, light, world)
    directly = model.accel(0.0, state[:3] + apart[0], state[3:] + apart[1], light, world) - accel_of(
        model, state, world
    )
    np.testing.assert_allclose(relative, directly, rtol=0, atol=1e-14)


def test_the_same_force_as_a_pytree_is_swept(state):
    @forces.force
    class Push:
        newtons: object = 1.0
        needs = frozenset()

        def accel(self, t, r, v, spacecraft, environment):
            return self.newtons / spacecraft.mass * v

    def size(newtons):
        return jnp.sum(accel_of(ForceModel((PointMass(), Push(newtons))), state, forces.Environment()))

    np.testing.assert_allclose(jax.jit(jax.grad(size))(2.0), jnp.sum(state[3:]) / 12000.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Zonal(7), "degree: expected a static integer from 0 to 6, got 7"),
        (lambda: ThirdBody("pluto"), "body: expected one of .* got 'pluto'"),
        (lambda: ForceModel(PointMass()), "forces: expected a tuple of forces, got PointMass"),
        (lambda: ForceModel((PointMass,)), "forces: expected a tuple of at least one force"),
        (lambda: ForceModel(()), "forces: expected a tuple of at least one force"),
        (lambda: ForceModel((ThirdBody("ceres", 6e10),)).environment(61253, 0.0), "'ceres' is needed and not computed"),
        (lambda: ForceModel(FORCES).environment(61253, 0.0, son=jnp.ones(3)), "given: expected fields of Environment"),
        (
            lambda: ThirdBody("sun").accel(0.0, jnp.ones(3), jnp.ones(3), CRAFT, forces.Environment()),
            "environment: ThirdBody needs 'sun'",
        ),
        (
            lambda: Drag().accel(0.0, jnp.ones(3), jnp.ones(3), Spacecraft(1.0), forces.Environment()),
            "spacecraft.drag_area: Drag needs it",
        ),
        (
            lambda: ForceModel((PointMass(),), jnp.ones(2)).accel(
                0.0, jnp.ones(3), jnp.ones(3), CRAFT, forces.Environment()
            ),
            r"weights: expected shape \(1,\), got \(2,\)",
        ),
    ],
)
def test_mistakes_are_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()


def test_planets_stand_where_the_ephemeris_has_them(state):
    world = ForceModel((PointMass(), ThirdBody("venus"), ThirdBody("mars"))).environment(61253, 0.0)
    assert set(world.planets) == {"venus", "mars"}
    expected = ephemeris.planet_position_geocentric("mars", 61253, 0.0)
    np.testing.assert_allclose(world.planets["mars"], expected, rtol=1e-12)


def test_planets_are_given(state):
    jupiter = jnp.asarray([6e11, 2e11, 1e11])
    model = ForceModel((PointMass(), ThirdBody("jupiter")))
    world = model.environment(61253, 0.0, planets={"jupiter": jupiter})
    extra = accel_of(model, state, world) - forces.accel_two_body(state[:3])
    expected = forces.accel_third_body(state[:3], jupiter, forces.GM_BODIES["jupiter"])
    np.testing.assert_allclose(extra, expected, rtol=0, atol=3e-15)
