"""Train PPO pilots inside one compiled program: `python examples/train_jax_ppo.py [--updates N] [--seeds K]`.

Environment steps, automatic reset, advantages, minibatch epochs and logging are one `lax.scan`, called once per line of
the log; `--seeds K` trains K pilots in it by `vmap`. The task is that of `train_sb3_ppo.py`: one port (Zvezda
aft), two minutes, starts at 75 to 100 m with the nose on the station, less torque, more weight on progress and less on
escape, and the goal error in the chaser's axes appended. So are the settings, but for the learning rate, which falls to
zero, and the initial weights. There is no curriculum. Nothing but the collision charge tells the pilot of the hull.

Needs `pip install optax matplotlib` beside `outofthisworldmodel-envs`; both come with `outofthisworldmodel`.
"""

import argparse
import time
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from astrojax.attitude import quat_conjugate, quat_rotate
from owm_envs.env import DockingEnv, EnvState
from owm_envs.task.events import Outcome
from owm_envs.view import View

EASIER = {
    "ports": ["zvezda_aft"],
    "reset": {"radius_min": 75.0, "radius_max": 100.0, "attitude_error_deg": 0.0, "rate": 0.0},
    "chaser": {"torque_limit": 600.0},
    "reward": {"progress": -50.0, "escape": -20.0},
}
GAMMA, LAMBDA, CLIP, VALUE_WEIGHT, EPOCHS, MINIBATCHES, WIDTH = 0.99, 0.95, 0.2, 0.5, 8, 15, 64
OPTIMIZER = optax.flatten(optax.chain(optax.clip_by_global_norm(0.5), optax.adam(5e-4, eps=1e-5)))


class Moments(NamedTuple):
    """Running mean and variance of what was seen so far."""

    mean: jax.Array
    variance: jax.Array
    count: jax.Array

    def merge(self, batch: jax.Array) -> "Moments":
        """With a batch (N, ...) more. Source: Chan, Golub and LeVeque (1979)."""
        total = self.count + batch.shape[0]
        shift, share = batch.mean(0) - self.mean, batch.shape[0] / total
        variance = self.variance * (1 - share) + batch.var(0) * share + shift**2 * share * (1 - share)
        return Moments(self.mean + shift * share, variance, total)


class Pilot(NamedTuple):
    """What it takes to fly: networks as [(weight, bias), ...], exploration, and the observations' moments."""

    actor: list
    critic: list
    log_std: jax.Array
    seen: Moments

    def normalize(self, features: jax.Array) -> jax.Array:
        return jnp.clip((features - self.seen.mean) / jnp.sqrt(self.seen.variance + 1e-8), -10, 10)


class Slots(NamedTuple):
    """The batch of running episodes."""

    states: EnvState
    features: jax.Array
    discounted: jax.Array
    earned: jax.Array


class Agent(NamedTuple):
    """All that training carries from one update to the next."""

    pilot: Pilot
    optimizer: Any
    earned_moments: Moments
    """Of the discounted reward so far, by whose spread rewards are divided."""
    slots: Slots
    done: jax.Array
    """Updates, of those planned: the learning rate falls to zero with them."""
    key: jax.Array


def network(key: jax.Array, sizes: tuple[int, ...], final: float) -> list:
    """Normal weights of variance 1 / inputs and zero biases; the last layer scaled by `final`."""
    layers = []
    for n, (inputs, outputs) in enumerate(pairwise(sizes)):
        scale = (final if n == len(sizes) - 2 else 1.0) / inputs**0.5
        weight = scale * jax.random.normal(jax.random.fold_in(key, n), (inputs, outputs), jnp.float32)
        layers.append((weight, jnp.zeros(outputs, jnp.float32)))
    return layers


def forward(layers: list, x: jax.Array) -> jax.Array:
    *hidden, (weight, bias) = layers
    for w, b in hidden:
        x = jnp.tanh(x @ w + b)
    return x @ weight + bias


def log_density(mean: jax.Array, log_std: jax.Array, action: jax.Array) -> jax.Array:
    return jnp.sum(-0.5 * ((action - mean) / jnp.exp(log_std)) ** 2 - log_std - 0.5 * np.log(2 * np.pi), axis=-1)


def features(env: DockingEnv, observation: dict[str, jax.Array]) -> jax.Array:
    """The observation and its position and velocity errors in the chaser's axes, where the thrusters push."""
    state = observation["state"]
    to_body = quat_conjugate(View.of(state[env.layout.view]).attitude)
    position, velocity = state[-12:-9], state[-9:-6]
    return jnp.concatenate([state, quat_rotate(to_body, position), quat_rotate(to_body, velocity)])


def start(env: DockingEnv, params, key: jax.Array) -> tuple[EnvState, jax.Array]:
    state, observation = env.reset(params, key=key)
    return state, features(env, observation)


def new_agent(states: EnvState, seen: jax.Array, key: jax.Array) -> Agent:
    """An untrained pilot in slots that have just started."""
    actor, critic, key = jax.random.split(key, 3)
    envs, size = seen.shape
    zeros = jnp.zeros(envs, jnp.float32)
    pilot = Pilot(
        network(actor, (size, WIDTH, WIDTH, 6), 0.01),
        network(critic, (size, WIDTH, WIDTH, 1), 1.0),
        jnp.full(6, -1.0, jnp.float32),
        Moments(jnp.zeros(size, jnp.float32), jnp.ones(size, jnp.float32), jnp.float32(1e-4)),
    )
    earned = Moments(jnp.float32(0), jnp.float32(1), jnp.float32(1e-4))
    return Agent(pilot, OPTIMIZER.init(pilot[:3]), earned, Slots(states, seen, zeros, zeros), jnp.float32(0), key)


def decide(env: DockingEnv, params, pilot: Pilot, slots: Slots, key: jax.Array) -> tuple[Slots, dict[str, Any]]:
    """One decision of every slot; those whose episode ends start the next one. Also what is to be learned from it."""
    seen = pilot.normalize(slots.features)
    mean = forward(pilot.actor, seen)
    action = mean + jnp.exp(pilot.log_std) * jax.random.normal(key, mean.shape, jnp.float32)
    states, result = jax.vmap(env.step, (None, 0, 0))(params, slots.states, action)  # clips to the wrench limits
    last = jax.vmap(partial(features, env))(result.observation)
    reward = result.reward.astype(jnp.float32)
    done = result.terminated | result.truncated
    now = Slots(states, last, GAMMA * slots.discounted + reward, slots.earned + reward)
    row = {"seen": seen, "action": action, "log_prob": log_density(mean, pilot.log_std, action), "reward": reward}
    row |= {"features": slots.features, "last": last, "discounted": now.discounted}
    row |= {"terminated": result.terminated, "done": done}
    row["episode"] = {"return": now.earned, "docked": states.outcome == Outcome.DOCKED, "touched": states.collided}

    fresh, first = jax.vmap(partial(start, env, params))(states.next_key)
    following = Slots(fresh, first, jnp.zeros_like(reward), jnp.zeros_like(reward))
    ended = lambda new, old: jnp.where(jnp.reshape(done, done.shape + (1,) * (new.ndim - 1)), new, old)
    return jax.tree.map(ended, following, now), row


def advantages(values, next_values, reward, terminated, done) -> jax.Array:
    """Generalised advantages (T, B). Source: Schulman et al. (2016), equation 16.

    A terminated episode has no future; one that the horizon cut off has the value of where it stopped.
    """
    surprise = reward + GAMMA * jnp.where(terminated, 0, next_values) - values

    def back(later, row):
        now = row[0] + GAMMA * LAMBDA * jnp.where(row[1], 0, later)
        return now, now

    return jax.lax.scan(back, jnp.zeros_like(values[0]), (surprise, done), reverse=True)[1]


def loss(weights, batch) -> jax.Array:
    """PPO's clipped surrogate and the critic's squared error. Source: Schulman et al. (2017), equation 7."""
    actor, critic, log_std = weights
    seen, action, old, advantage, target = batch
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    ratio = jnp.exp(log_density(forward(actor, seen), log_std, action) - old)
    surrogate = jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - CLIP, 1 + CLIP) * advantage)
    return -surrogate.mean() + VALUE_WEIGHT * jnp.mean((forward(critic, seen)[:, 0] - target) ** 2)


def update(env: DockingEnv, steps: int, planned: int, params, agent: Agent) -> tuple[Agent, dict[str, jax.Array]]:
    """Fly `steps` decisions in every slot and learn from them; also the means over the episodes that ended."""
    pilot = agent.pilot
    key, flight, learning = jax.random.split(agent.key, 3)
    slots, rows = jax.lax.scan(partial(decide, env, params, pilot), agent.slots, jax.random.split(flight, steps))

    earned_moments = agent.earned_moments.merge(rows["discounted"].reshape(-1))
    reward = jnp.clip(rows["reward"] / jnp.sqrt(earned_moments.variance + 1e-8), -10, 10)
    values = forward(pilot.critic, rows["seen"])[..., 0]
    next_values = forward(pilot.critic, pilot.normalize(rows["last"]))[..., 0]
    advantage = advantages(values, next_values, reward, rows["terminated"], rows["done"])
    batch = (rows["seen"], rows["action"], rows["log_prob"], advantage, advantage + values)
    batch = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)

    def minibatch(carry, chosen):
        weights, optimizer = carry
        gradient = jax.grad(loss)(weights, jax.tree.map(lambda x: x[chosen], batch))
        change, optimizer = OPTIMIZER.update(gradient, optimizer)
        change = jax.tree.map(lambda x: x * (1 - agent.done / planned), change)
        return (optax.apply_updates(weights, change), optimizer), None

    def epoch(carry, key):
        order = jax.random.permutation(key, advantage.size)[: advantage.size // MINIBATCHES * MINIBATCHES]
        return jax.lax.scan(minibatch, carry, order.reshape(MINIBATCHES, -1))

    carry = (tuple(pilot[:3]), agent.optimizer)
    (weights, optimizer), _ = jax.lax.scan(epoch, carry, jax.random.split(learning, EPOCHS))
    seen = pilot.seen.merge(rows["features"].reshape(-1, rows["features"].shape[-1]))
    ended = jnp.maximum(rows["done"].sum(), 1)
    means = {name: jnp.sum(jnp.where(rows["done"], value, 0)) / ended for name, value in rows["episode"].items()}
    return Agent(Pilot(*weights, seen), optimizer, earned_moments, slots, agent.done + 1, key), means


def evaluate(env: DockingEnv, steps: int, params, starts, pilot: Pilot) -> dict[str, jax.Array]:
    """Fly an episode from each of `starts` without exploring."""

    def fly(carry, _):
        states, seen = carry
        action = forward(pilot.actor, pilot.normalize(seen))
        states, result = jax.vmap(env.step, (None, 0, 0))(params, states, action)
        return (states, jax.vmap(partial(features, env))(result.observation)), result.reward

    (states, _), reward = jax.lax.scan(fly, starts, length=steps)
    figures = {"return": reward.sum(0).mean(), "closest [m]": jnp.median(states.closest.distance)}
    figures |= {"within 1 m [%]": 100 * jnp.mean(states.closest.distance < 1)}
    figures |= {"docked [%]": 100 * jnp.mean(states.outcome == Outcome.DOCKED)}
    return figures | {"touched the hull [%]": 100 * jnp.mean(states.collided)}


def report(name: str, figures: dict[str, jax.Array]) -> None:
    """A line of means over the pilots."""
    print(f"{name:<27}", *(f"{key} {np.mean(value):7.2f} " for key, value in figures.items()), flush=True)


def save(file: Path, pilots: Pilot) -> None:
    """Weights and normalisation of all pilots, one array a leaf, their seeds along its first axis."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(pilots)
    np.savez(file, **{jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves})


def load(file: Path, like: Pilot) -> Pilot:
    """What `save` wrote, in the structure of `like`."""
    leaves, structure = jax.tree_util.tree_flatten_with_path(like)
    with np.load(file) as saved:
        return structure.unflatten([jnp.asarray(saved[jax.tree_util.keystr(path)]) for path, _ in leaves])


def plot(curves, trials, frames: np.ndarray, idle: float, title: str, file: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    steps = np.linspace(0, frames[-1], len(curves["return"]) + 1)[1:]
    left.plot(steps / 1e6, curves["return"].mean(1), color="0.5", label="while training (exploring)")
    left.axhline(idle, color="k", linestyle=":", linewidth=1, label=f"no thrust: {idle:.0f}")
    names = {"return": "on trial (not exploring)"} | {name: name for name in trials if "%" in name}
    for (name, label), color in zip(names.items(), ("C0", "C2", "C3", "C0")):
        axes = left if name == "return" else right
        axes.plot(frames / 1e6, trials[name].mean(1), ".-", color=color, label=label)
        axes.plot(frames / 1e6, trials[name], color=color, alpha=0.3, linewidth=0.8)
    left.set(xlabel="million frames per pilot", ylabel="episode return")
    left.set_yscale("symlog", linthresh=100)
    right.set(xlabel="million frames per pilot", ylabel="% of trial flights", ylim=(-3, 103))
    left.legend()
    right.legend()
    figure.suptitle(title)
    figure.savefig(file, dpi=150)


def main(arguments: list[str] | None = None) -> dict[str, Any]:
    """Train in the precision that the fidelity needs; returns what was plotted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", default="iss-hcw", help="iss, iss-hcw (both float32) or iss-numerical (float64)")
    parser.add_argument("--updates", type=int, default=100, help="of envs x horizon frames each")
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop training after this long, if earlier")
    parser.add_argument("--chunk", type=int, default=5, help="updates per call of the compiled program")
    parser.add_argument("--envs", type=int, default=128, help="per pilot")
    parser.add_argument("--horizon", type=int, default=120, help="s per episode, at one decision a second")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=1, help="pilots to train at once")
    parser.add_argument("--out", type=Path, default=Path("runs/jax_ppo"))
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    with jax.enable_x64(options.fidelity == "iss-numerical"):  # the networks are float32 either way
        return train(options)


def train(options: argparse.Namespace) -> dict[str, Any]:
    """Trial flights at every call; the trained pilots are judged as read back from their file."""
    precision = "float64" if options.fidelity == "iss-numerical" else "float32"
    task = {"fidelity": options.fidelity, "precision": precision, "normalize": True, "horizon": float(options.horizon)}
    env = DockingEnv(preset="rl", **task, **EASIER)
    params, frames = env.default_params(), options.envs * options.horizon
    begin = jax.jit(jax.vmap(partial(start, env, params)))
    trial_starts = begin(jax.random.split(jax.random.key(10_000), options.envs))
    trial = jax.jit(jax.vmap(partial(evaluate, env, options.horizon, params, trial_starts)))
    calls = -(-options.updates // options.chunk)
    one = partial(update, env, options.horizon, calls * options.chunk)

    @partial(jax.jit, donate_argnums=1)
    def program(params, agents):
        return jax.lax.scan(lambda now, _: jax.vmap(one, (None, 0))(params, now), agents, length=options.chunk)

    keys = jax.random.split(jax.random.key(options.seed), options.seeds)
    born = jax.jit(new_agent)
    each = [born(*begin(jax.random.split(key, options.envs)), jax.random.fold_in(key, 0)) for key in keys]
    agents = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    idle = trial(agents.pilot._replace(actor=jax.tree.map(jnp.zeros_like, agents.pilot.actor)))
    report("no thrust", idle)
    trials, curves, spent = [trial(agents.pilot)], [], 0.0
    report("before", trials[0])
    began = time.perf_counter()
    program = program.lower(params, agents).compile()
    compiled = time.perf_counter() - began
    with Progress(TextColumn("compiled in {task.fields[s]:.1f} s"), BarColumn(), TimeElapsedColumn()) as bar:
        line = bar.add_task("", total=calls, s=compiled)
        while len(curves) < calls and spent < 60 * options.minutes:
            began = time.perf_counter()
            agents, means = jax.block_until_ready(program(params, agents))
            spent += time.perf_counter() - began
            curves.append(means)
            trials.append(trial(agents.pilot))
            report(f"{len(curves) * options.chunk * frames:>11,} frames {spent:6.1f} s", trials[-1])
            bar.update(line, advance=1)

    save(options.out / "pilot.npz", agents.pilot)
    after = trial(load(options.out / "pilot.npz", agents.pilot))
    report("after, from the file", after)
    flown = len(curves) * options.chunk * frames * options.seeds
    print(f"{flown:,} frames in {spent:.1f} s: {flown / spent:,.0f} frames/s, learning included, trials not")
    curves = jax.tree.map(lambda *chunks: np.concatenate(chunks), *curves)
    trials = jax.tree.map(lambda *each: np.stack(each), *trials)
    title = f"PPO in one compiled program: {spent:.0f} s, {options.seeds} pilot{'s' * (options.seeds > 1)}"
    tried = frames * options.chunk * np.arange(len(trials["return"]))
    plot(curves, trials, tried, float(np.mean(idle["return"])), title, options.out / "learning_curve.png")
    print(f"saved pilot.npz and learning_curve.png in {options.out}")
    return {"trials": trials, "after": after, "curves": curves, "frames_per_s": flown / spent}


if __name__ == "__main__":
    main()
