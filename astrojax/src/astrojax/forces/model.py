"""The sum of the forces, ready for an integrator."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from astrojax._types import Scalar, Vector3, Vector6
from astrojax.forces.base import Traced, force, relative_acceleration
from astrojax.forces.environment import Environment, environment_at
from astrojax.forces.spacecraft import Spacecraft


@force
class ForceModel:
    """The sum of some forces; itself a pytree, so that it may be closed over, swept or differentiated.

    Args:
        forces: tuple of `Force`s. The largest goes first: it is added last, so that the small ones keep their digits.
        weights: (N,) one factor a force, traced: sweeping which forces act recompiles nothing. None: all act, and no
            factor is multiplied.

    Raises: ValueError, `forces` is not a tuple of forces, or `weights` has another length.
    """

    forces: Traced
    weights: Traced = None

    def __post_init__(self) -> None:
        # Trees rebuild themselves through here with anything in their leaves' place: only what a caller gets wrong
        # is looked at.
        if hasattr(self.forces, "accel") or isinstance(self.forces, list):
            raise ValueError(f"forces: expected a tuple of forces, got {type(self.forces).__name__}")
        if isinstance(self.forces, tuple):
            wrong = [f for f in self.forces if isinstance(f, (type, str)) or (callable(f) and not hasattr(f, "accel"))]
            if wrong or not self.forces:
                raise ValueError(f"forces: expected a tuple of at least one force, got {wrong or self.forces!r}")

    @property
    def needs(self) -> frozenset[str]:
        """All that the forces read of the environment."""
        return frozenset().union(*(f.needs for f in self.forces))

    def environment(self, day: Scalar, seconds: Scalar, **given: Any) -> Environment:
        """What these forces need to know at a UTC epoch, and no more; arguments as of `environment_at`."""
        return environment_at(self.needs, day, seconds, **given)

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2] of all forces.

        Args:
            t: time [s], handed to the forces.
            r: (3,) inertial position [m].
            v: (3,) inertial velocity [m/s].
            spacecraft: what they act on.
            environment: from `environment`.
        """
        return self._sum([f.accel(t, r, v, spacecraft, environment) for f in self.forces], last=True)

    def relative(
        self,
        t: Scalar,
        r: Vector3,
        v: Vector3,
        rho: Vector3,
        rho_dot: Vector3,
        chief: Spacecraft,
        spacecraft: Spacecraft,
        environment: Environment,
    ) -> Vector3:
        """Acceleration [m/s^2] of a vehicle less that of a chief nearby, without subtracting two attractions.

        Args:
            t: time [s], handed to the forces.
            r, v: (3,) inertial position and velocity of the chief [m, m/s].
            rho, rho_dot: (3,) position and velocity of the vehicle less the chief's [m, m/s], inertial axes.
            chief, spacecraft: what the forces act on, at r and at r + rho.
            environment: from `environment`, for both.

        Validity: any separation. In float32 it keeps the precision of the separation, as each force's own `relative`
        says (the zonal terms': third order, 2e-13 m/s^2 at 1 km).
        """
        both = (t, r, v, rho, rho_dot, chief, spacecraft, environment)
        return self._sum([relative_acceleration(f, *both) for f in self.forces], last=False)

    def derivative(
        self,
        t: Scalar,
        state: Vector6,
        spacecraft: Spacecraft,
        environment: Environment | Callable[[Scalar], Environment],
    ) -> Vector6:
        """Time derivative of a state, in the form `rk4_step(model.derivative, t, state, dt, spacecraft, environment)`.

        Args:
            t: time [s].
            state: (6,) inertial position and velocity [m, m/s].
            spacecraft: what the forces act on.
            environment: held over the step; or a function of t, called each stage: with t in seconds of a day,
                `functools.partial(model.environment, day)`.
        """
        if callable(environment):
            environment = environment(t)
        r, v = state[:3], state[3:]
        return jnp.concatenate([v, self.accel(t, r, v, spacecraft, environment)])

    def _sum(self, terms: list[Vector3], last: bool) -> Vector3:
        if self.weights is not None:
            if jnp.shape(self.weights) != (len(terms),):
                raise ValueError(f"weights: expected shape ({len(terms)},), got {jnp.shape(self.weights)}")
            weights = jnp.asarray(self.weights, terms[0].dtype)
            terms = [weights[i] * term for i, term in enumerate(terms)]
        first, *rest = terms
        if last and rest:
            return first + sum(rest[1:], rest[0])
        return sum(rest, first)
