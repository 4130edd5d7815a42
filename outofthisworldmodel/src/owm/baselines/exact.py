"""The environment's own equations of motion as a world model: what perfect dynamics would buy."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from astrojax.attitude import quat_normalize
from astrojax.time import normalize_epoch
from owm.interface import History
from owm_envs.config import FIDELITIES, DockingConfig, Fidelity, load_config
from owm_envs.config.params import ChaserParams, ChiefParams, params_from_config
from owm_envs.dynamics import DYNAMICS, Dynamics, PhysicalState
from owm_envs.task.sensors import STATE
from owm_envs.view import View
from owm_envs.words import unknown


class ExactParams(NamedTuple):
    """The physical constants that the equations of motion read."""

    chief: ChiefParams
    chaser: ChaserParams


@dataclass(frozen=True)
class ExactDynamics:
    """The equations of motion of a fidelity, started from the last measurement, noise and all.

    It is given mass, inertia, drag and the station's orbit, but not the time: the station is taken to be
    where it is at the reference epoch, which moves the small perturbations along the orbit but nothing else.
    Commands are taken
    to be delivered as they are: thrust scale, misalignment, delay and pulses are not modelled. One RK4 step of `dt`
    replaces the environment's five.

    Args:
        fidelity: one of `FIDELITIES`; "iss-numerical" computes in float64 and must be called in JAX's 64-bit
            mode.
        config: the environment whose vehicles to take; the default one when None.
        history_length: `H` to report, so that it takes the same histories as the model beside it.
        dt: seconds a step.

    Raises:
        ValueError: the fidelity is unknown (naming the nearest).
    """

    fidelity: Fidelity = "iss-numerical"
    config: DockingConfig | None = field(default=None, compare=False, repr=False)
    history_length: int = 8
    dt: float = 0.25
    dynamics: Dynamics = field(init=False, repr=False)
    params: ExactParams = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.fidelity not in FIDELITIES:
            raise ValueError(unknown("fidelity", self.fidelity, FIDELITIES))
        config = load_config(self.config, fidelity=self.fidelity, precision=self.precision)
        with jax.enable_x64(self.precision == "float64"):
            # NumPy leaves: a float64 JAX array would narrow wherever it is touched outside the 64-bit mode.
            params = jax.device_get(params_from_config(config))
        object.__setattr__(self, "dynamics", DYNAMICS[self.fidelity](config))
        object.__setattr__(self, "params", ExactParams(params.chief, params.chaser))

    @property
    def name(self) -> str:
        """What reports call it."""
        return f"exact dynamics ({self.fidelity})"

    @property
    def precision(self) -> str:
        """The dtype that its numbers need."""
        return "float64" if self.fidelity == "iss-numerical" else "float32"

    def encode(self, params: ExactParams, history: History) -> PhysicalState:
        """Start from the last measurement at the reference epoch.

        Raises:
            RuntimeError: float64 is needed and JAX's 64-bit mode is off.
        """
        return self.start(params, params.chief.epoch, history.observation[STATE][-1])

    def step(
        self, params: ExactParams, key: Key[Array, ""] | None, action: Float[Array, "6"], state: PhysicalState
    ) -> PhysicalState:
        """Advance by `dt` under a held body wrench; deterministic with or without a key."""
        dtype = state.elapsed.dtype
        return self.dynamics.step(_arrays(params), state, action.astype(dtype), jnp.asarray(self.dt, dtype))

    def observe(
        self,
        params: ExactParams,
        state: PhysicalState,
        action: Float[Array, "6"],
        observation: dict[str, Array],
    ) -> PhysicalState:
        """Start again from the measurement, one step later."""
        epoch = jnp.stack(normalize_epoch(state.epoch[0], state.epoch[1] + state.elapsed + self.dt))
        return self.start(params, epoch, observation[STATE])

    def decode(self, params: ExactParams, state: PhysicalState) -> dict[str, Array]:
        """Return the view in the station frame."""
        return {"state": self.dynamics.relative_state(_arrays(params), state)}

    def start(self, params: ExactParams, epoch: Float[Array, "2"], view: Float[Array, "13"]) -> PhysicalState:
        """Start from a view at an epoch [MJD day, s of day].

        Raises:
            RuntimeError: float64 is needed and JAX's 64-bit mode is off.
        """
        dtype = jnp.dtype(self.precision)
        if jax.dtypes.canonicalize_dtype(dtype) != dtype:
            raise RuntimeError(
                f"{self.name} needs JAX's 64-bit mode: work inside `with jax.enable_x64(True):` "
                "(PlannerPolicy does so by itself)"
            )
        view = jnp.asarray(view, dtype)
        _, _, attitude, rate = View.of(view)
        view = jnp.concatenate([view[:6], quat_normalize(attitude), rate])
        return self.dynamics.init(_arrays(params), jnp.asarray(epoch, dtype), view)


def _arrays(params: ExactParams) -> ExactParams:
    """The NumPy numbers of a model as arrays of the mode that is on, as the equations of motion take them."""
    return jax.tree.map(jnp.asarray, params)
