"""Dock by the gradient of a shooting problem: `python examples/shooting.py`.

A minute of flight to the nearest port, as forces and torques held for three seconds each, all 1200 steps of it through
`DockingEnv.step`. The cost is the final goal error in units of the docking tolerances, plus effort:

    J(u) = 1/2 |e(u) / tolerance|^2 + w/2 |u|^2

Reverse mode through the whole episode gives the Jacobian of the twelve errors, hence the gradient of J (compared with
finite differences) and Gauss-Newton steps, damped after Levenberg and Marquardt. Gradients stop at the collision test,
so nothing steers around the hull: flying the result with docking and collisions on shows whether it came near.

Needs `pip install matplotlib` beside `outofthisworldmodel-envs`; it comes with `outofthisworldmodel`.
"""

import argparse
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from owm_envs.env import DockingEnv
from owm_envs.station import PORT_NAMES
from owm_envs.task.events import Outcome
from owm_envs.view import View

HOLD = 60  # steps of 0.05 s
EFFORT = 0.1


def problem(fidelity: str, seed: int):
    """Environment, its parameters and a start 65 to 75 m from the station's origin, for the nearest port."""
    reset = {"radius_min": 65.0, "radius_max": 75.0}
    env = DockingEnv(fidelity=fidelity, reset=reset, normalize=True)  # actions in fractions of the limits
    params = env.default_params()
    begin = jax.jit(env.reset)
    state, _ = begin(params, key=jax.random.key(seed))
    port = jnp.argmin(jnp.linalg.norm(params.goals[:, :3] - View.of(state.view).position, axis=1))
    state, _ = begin(params, key=jax.random.key(seed), port=port)
    return env, params, state


def programs(env: DockingEnv, params, state):
    """Compiled: from controls the final error over tolerance and its Jacobian; the error alone; a flight for real."""
    tolerance = jnp.repeat(jnp.stack(params.docking), 3)
    # An episode that has docked stands still, and so would the gradient of what follows: aim with zero tolerances.
    # They are numbers in `params`, so flying with and without them is one program.
    aim = params._replace(docking=jax.tree.map(jnp.zeros_like, params.docking))

    def fly(params, controls, record=True):
        def step(state, action):
            state, _ = env.step(params, state, action)
            return state, state if record else None

        final, path = jax.lax.scan(step, state, jnp.repeat(controls, HOLD, axis=0))
        return env.info(params, final)["true_goal_error"] / tolerance, path

    def linearize(controls):
        error, pull = jax.vjp(lambda controls: fly(aim, controls, record=False)[0], controls)
        (jacobian,) = jax.vmap(pull)(jnp.eye(12))
        return error, jacobian

    flight = jax.jit(fly)
    return jax.jit(linearize), lambda controls: flight(aim, controls)[0], lambda controls: flight(params, controls)[1]


def cost(error, controls) -> float:
    return float(0.5 * np.sum(error**2) + 0.5 * EFFORT * np.sum(controls**2))


def check_gradient(errors, error, jacobian, controls, step: float = 1e-4) -> float:
    """Largest relative difference of dJ along three random directions to central differences."""
    gradient = np.tensordot(error, jacobian, 1) + EFFORT * controls
    worst = 0.0
    for direction in np.random.default_rng(0).normal(size=(3, *controls.shape)):
        ahead, behind = (
            cost(np.asarray(errors(u)), u) for u in (controls + step * direction, controls - step * direction)
        )
        difference = (ahead - behind) / (2 * step)
        ours = float(np.sum(gradient * direction))
        print(f"  along a random direction: reverse mode {ours:+.8e}   central difference {difference:+.8e}")
        worst = max(worst, abs(ours - difference) / abs(difference))
    return worst


def solve(linearize, controls, iterations: int):
    """Levenberg-Marquardt; returns the controls and a row (cost, m, m/s, deg, deg/s, damping) per iteration."""
    damping, rows = 1e-3, []
    error, jacobian = map(np.asarray, linearize(controls))
    now = cost(error, controls)
    print("iteration          cost  position m   speed m/s   attitude deg   rate deg/s   damping")
    for number in range(iterations + 1):
        norms = np.linalg.norm(error.reshape(4, 3), axis=1) * [0.1, 0.5, 5.0, 0.5]
        rows.append((now, *norms, damping))
        print(
            f"{number:>9}  {now:>12.6g}"
            + "  {:>10.3e}  {:>10.3e}  {:>13.3e}  {:>11.3e}  {:>8.0e}".format(*norms, damping)
        )
        if number == iterations:
            break
        flat = jacobian.reshape(12, -1)
        gradient = error @ flat + EFFORT * controls.ravel()
        curvature = flat.T @ flat + EFFORT * np.eye(gradient.size)
        while damping < 1e9:
            trial = controls - np.linalg.solve(curvature + damping * np.eye(gradient.size), gradient).reshape(
                controls.shape
            )
            trial_error, trial_jacobian = map(np.asarray, linearize(trial))
            if (then := cost(trial_error, trial)) < now:
                break
            damping *= 10
        else:
            break
        gained, now = now - then, then
        controls, error, jacobian, damping = trial, trial_error, trial_jacobian, damping / 10
        if gained < 1e-4 * now:
            break
    return controls, rows


def main(arguments: list[str] | None = None) -> dict:
    """Check the gradient, iterate, fly the result for real and plot it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", default="iss-numerical")
    parser.add_argument("--seconds", type=int, default=60, help="of flight")
    parser.add_argument("--iterations", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/shooting"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    with jax.enable_x64(True):
        began = time.perf_counter()
        env, params, state = problem(options.fidelity, options.seed)
        port = PORT_NAMES[int(state.port)]
        print(f"{options.fidelity}, to {port} from {float(state.closest.distance):.1f} m in {options.seconds} s")
        linearize, errors, fly = programs(env, params, state)
        controls = np.zeros((round(options.seconds / (HOLD * env.config.dt)), 6))
        error, jacobian = map(np.asarray, linearize(controls))
        print(f"compiled after {time.perf_counter() - began:.1f} s")
        mismatch = check_gradient(errors, error, jacobian, controls)
        controls, rows = solve(linearize, controls, options.iterations)
        path = jax.device_get(fly(controls))
    final = jax.tree.map(lambda x: x[-1], path)
    outcome = Outcome(int(final.outcome)).name.lower()
    wrench = controls * np.repeat([env.config.chaser.force_limit, env.config.chaser.torque_limit], 3)
    delta_v = np.abs(wrench[:, :3]).sum() * HOLD * env.config.dt / env.config.chaser.mass
    print(
        f"flown at 20 Hz, docking and collisions on: {outcome} after {float(final.physics.elapsed):.2f} s, hull "
        f"{'touched' if final.collided else 'not touched'} (nearest {float(final.clearance.least):.2f} m)\n"
        f"largest control {np.abs(controls).max():.0%} of its limit, delta-v {delta_v:.2f} m/s; "
        f"{time.perf_counter() - began:.1f} s in all"
    )
    picture = options.out / "shooting.png"
    plot(env, jax.device_get(params), path, wrench, rows, f"{port}: {outcome}", picture)
    print(f"saved {picture}")
    return {"mismatch": mismatch, "costs": [row[0] for row in rows], "outcome": outcome, "controls": controls}


def plot(env, params, path, wrench, rows, title: str, file: Path) -> None:
    """Paths from above and from the side, controls, and convergence."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    figure, ((top, side), (control, descent)) = plt.subplots(2, 2, figsize=(11, 8), layout="constrained")
    flown = path.outcome == Outcome.RUNNING
    goal = params.goals[int(path.port[0])]
    for axes, across, name in ((top, 0, "port side x [m]"), (side, 2, "zenith z [m]")):
        low, high = params.hull[:, 0][:, [1, across]], params.hull[:, 1][:, [1, across]]
        corners = [[(a, b), (c, b), (c, d), (a, d)] for (a, b), (c, d) in zip(low, high)]
        axes.add_collection(PolyCollection(corners, facecolor="0.85", edgecolor="0.6", linewidth=0.3))
        axes.plot(*path.view[flown][:, [1, across]].T, color="C0", label="path")
        axes.plot(*path.view[0, [1, across]], "o", color="C0", label="start")
        axes.plot(*goal[[1, across]], "x", color="C3", label="goal")
        axes.set(xlabel="aft y [m]", ylabel=name, aspect="equal")
        axes.autoscale_view()
    top.legend()
    top.set_title(title)
    edges = np.arange(len(wrench) + 1) * HOLD * env.config.dt
    for axis, color in enumerate(("C0", "C1", "C2")):
        control.stairs(wrench[:, axis], edges, color=color, label=f"force {'xyz'[axis]} [N]", baseline=None)
        control.stairs(
            wrench[:, axis + 3], edges, color=color, linestyle=":", label=f"torque {'xyz'[axis]} [N m]", baseline=None
        )
    control.set(xlabel="time [s]", title="controls, body axes")
    control.legend(ncols=2, fontsize=8)
    history = np.array(rows)
    for column, label in enumerate(("cost", "position [m]", "speed [m/s]", "attitude [deg]", "rate [deg/s]")):
        descent.semilogy(history[:, column], "k.-" if column == 0 else ".-", label=label)
    descent.set(xlabel="iteration", title="cost and final errors")
    descent.legend(fontsize=8)
    figure.savefig(file, dpi=130)


if __name__ == "__main__":
    main()
