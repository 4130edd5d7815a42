"""Recorded episodes as windows for training and scoring, in memory.

Recordings run at 20 Hz, the model steps at 4 Hz: every fifth measurement, and the mean of the five actions between.
Those of actions held as long as that may run at 4 Hz themselves.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from astrojax.attitude import quat_sign
from owm.interface import History
from owm_envs.datasets.windows import grid, mean_actions
from owm_envs.task.sensors import STATE, STATE_VALID
from owm_envs.view import VIEW_SIZE, View

STRIDE = 5
"""20 Hz frames in one model step of 0.25 s."""


class Windows(NamedTuple):
    """A batch of equally long cuts of episodes, none of which crosses an episode's end.

    Attributes:
        observation: parts by name, `dt` apart; "state" is the measured view.
        action: mean body force (N) and torque (N m) between one view and the next.
        truth: noiseless views; the measured ones where the recording has none.
    """

    observation: dict[str, Shaped[Array, "B L ..."]]
    action: Float[Array, "B L-1 6"]
    truth: Float[Array, "B L 13"]

    def last(self, length: int) -> "Windows":
        """The last `length` views of each."""
        observation = {name: values[:, -length:] for name, values in self.observation.items()}
        return Windows(observation, self.action[:, 1 - length :], self.truth[:, -length:])


@dataclass(frozen=True)
class Episodes:
    """Episodes at the model's rate, one after the other along the first axis.

    Attributes:
        observation: parts (N, ...) by name; "state" is the measured view, its quaternion continuous along each track.
        truth: (N, 13) noiseless views.
        action: (N, 6) mean action from a view to the next; the last row of a track is zero and never used.
        track: (N,) which track a row belongs to. A recording gives one track per phase at which the five-frame
            grid may start, or several between the times that relative navigation was quiet.
        episode: (N,) which recording a row came from.
        policies: behaviour policy of each recording.
        ports: port of each recording.
        dt: seconds between rows.
    """

    observation: dict[str, np.ndarray]
    truth: np.ndarray
    action: np.ndarray
    track: np.ndarray
    episode: np.ndarray
    policies: tuple[str, ...]
    ports: tuple[str, ...]
    dt: float

    def __len__(self) -> int:
        return len(self.policies)

    @property
    def view(self) -> Float[np.ndarray, "N 13"]:
        """The measured views."""
        return self.observation[STATE]

    @property
    def steps(self) -> int:
        """How many transitions the tracks hold."""
        return len(self.track) - len(np.unique(self.track))

    @property
    def longest(self) -> int:
        """Views in the longest track."""
        return int(np.bincount(self.track).max())

    def digest(self) -> str:
        """Return a fingerprint of the numbers."""
        sha = sha256()
        further = [self.observation[name] for name in sorted(self.observation) if name != STATE]
        for array in (self.view, self.action, self.track, *further):
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()[:16]

    def flown_by(self, policies: Collection[str], *, others: bool = False) -> "Episodes | None":
        """Return the recordings of some policies, or of all others; None if there are none."""
        keep = np.array([(policy in policies) != others for policy in self.policies], bool)
        if not keep.any():
            return None
        rows = keep[self.episode]
        number = np.cumsum(keep, dtype=np.int32) - 1
        kept = np.flatnonzero(keep)
        return replace(
            self,
            observation={name: values[rows] for name, values in self.observation.items()},
            **{name: getattr(self, name)[rows] for name in ("truth", "action", "track")},
            episode=number[self.episode[rows]],
            policies=tuple(self.policies[i] for i in kept),
            ports=tuple(self.ports[i] for i in kept),
        )

    def starts(self, length: int, *, check: bool = True) -> Int[np.ndarray, "S"]:
        """Return every row at which a window of `length` views fits into its track.

        Raises:
            ValueError: if no track is that long, unless `check` is False.
        """
        rows = len(self.track)
        first = np.arange(max(rows - length + 1, 0))
        first = first[self.track[first] == self.track[first + length - 1]].astype(np.int32)
        if check and len(first) == 0:
            longest = self.longest if rows else 0
            raise ValueError(f"no window of {length} views fits: the longest episode has {longest} at {self.dt} s")
        return first

    def windows(self, length: int, count: int | None = None, *, seed: int = 0) -> Windows:
        """Return windows of `length` views: `count` distinct ones drawn with `seed`, or as many as there are."""
        starts = self.starts(length)
        if count is not None and count < len(starts):
            starts = np.sort(np.random.default_rng(seed).choice(starts, count, replace=False))
        rows = starts[:, None] + np.arange(length)
        observation = {name: jnp.asarray(values[rows]) for name, values in self.observation.items()}
        return Windows(observation, jnp.asarray(self.action[rows[:, :-1]]), jnp.asarray(self.truth[rows]))


def from_episodes(episodes: Iterable[Any], *, phases: int = 1, dtype: str = "float32") -> Episodes:
    """Resample recorded episodes to the model's rate.

    Args:
        episodes: objects with `observation`, parts (T + 1, ...) by name of which "state" holds measured views
            (T + 1, 13), and `action` (T, 6), or (T + 1, 6) whose last, padded row is dropped; optionally `true_state`
            (T + 1, 13), `policy`, `port`, and `stride`, the frames in one step of the model, `STRIDE` unless given.
        phases: 1 to 5; at how many offsets the grid starts, of as many frames as are in a step. Every phase is a
            further track with noise and action means of its own.
        dtype: of the stored views and actions; further parts keep theirs.

    Raises:
        ValueError: on a wrong shape, a number that is not finite, other parts than in the first episode, or no episode
            long enough for one transition.
    """
    if not 1 <= phases <= STRIDE:
        raise ValueError(f"phases must be 1 to {STRIDE}, got {phases}")
    observation, truth, action, track, source = [], [], [], [], []
    policies, ports = [], []
    further: dict[str, list[np.ndarray]] = {}
    tracks = 0
    for number, episode in enumerate(episodes):
        parts = dict(episode.observation)  # a video is decoded at the rows taken, below
        seen = np.asarray(parts.pop(STATE, np.zeros(0)))
        fresh = np.asarray(parts.pop(STATE_VALID, np.ones(len(seen), bool))).reshape(-1)
        act = np.asarray(episode.action)
        true = getattr(episode, "true_state", None)
        true = seen if true is None else np.asarray(true)
        if seen.ndim != 2 or seen.shape[1] != VIEW_SIZE or true.shape != seen.shape:
            raise ValueError(
                f"episode {number}: state part must be (T + 1, {VIEW_SIZE}), got {seen.shape} with truth {true.shape}"
            )
        act = act[: len(seen) - 1]
        if act.shape != (len(seen) - 1, 6):
            raise ValueError(f"episode {number}: action must be ({len(seen) - 1}, 6), got {np.shape(episode.action)}")
        if not (np.isfinite(seen).all() and np.isfinite(true).all() and np.isfinite(act).all()):
            raise ValueError(f"episode {number}: state, true_state and action must be finite")
        further = further if number else {name: [] for name in parts}
        if parts.keys() != further.keys() or any(len(values) != len(seen) for values in parts.values()):
            raise ValueError(
                f"episode {number}: parts must be {', '.join(['state', *further])} of {len(seen)} rows each"
            )
        policies.append(str(getattr(episode, "policy", "")))
        ports.append(str(getattr(episode, "port", "")))
        stride = getattr(episode, "stride", STRIDE)
        for phase in range(min(phases, stride)):
            for rows in _measured(grid(len(act), stride, phase), fresh):
                mean = mean_actions(act, rows)
                observation.append(_continuous(seen[rows]).astype(dtype))
                for name, values in parts.items():
                    further[name].append(np.asarray(values[rows]))
                truth.append(_continuous(true[rows]).astype(dtype))
                action.append(np.concatenate([mean, np.zeros((1, 6))]).astype(dtype))
                track.append(np.full(len(rows), tracks, np.int32))
                source.append(np.full(len(rows), number, np.int32))
                tracks += 1
    if not observation:
        raise ValueError(f"no episode holds a transition: {len(policies)} given, {STRIDE + 1} frames needed")
    return Episodes(
        {STATE: np.concatenate(observation)} | {name: np.concatenate(pieces) for name, pieces in further.items()},
        *(np.concatenate(pieces) for pieces in (truth, action, track, source)),
        policies=tuple(policies),
        ports=tuple(ports),
        dt=0.05 * STRIDE,
    )


def _measured(rows: Int[np.ndarray, "R"], fresh: Bool[np.ndarray, "T"]) -> list[Int[np.ndarray, "S"]]:
    """Cut rows into stretches of two or more without one that was not measured."""
    gaps = np.flatnonzero(~fresh[rows])
    stretches = np.split(rows, np.unique([gaps, gaps + 1]))
    return [stretch for stretch in stretches if len(stretch) > 1 and fresh[stretch].all()]


def _continuous(views: np.ndarray) -> np.ndarray:
    """Flip quaternion signs so that neighbours along the first axis lie on the same side."""
    view = View.of(views)
    q = view.attitude
    sign = np.concatenate([[1.0], np.cumprod(quat_sign(q[1:], q[:-1]))])
    return view._replace(attitude=q * sign[:, None]).numbers()


def history_of(
    observation: dict[str, Shaped[Array, "L ..."]],
    action: Float[Array, "L-1 6"],
    length: int,
    context: Int[Array, ""] | int,
) -> History:
    """Cut the history of `length` from the start of a window, as if only its last `context` views existed."""
    first = length - jnp.asarray(context, jnp.int32)
    index = jnp.arange(length, dtype=jnp.int32)
    rows = jnp.maximum(index, first)
    return History({name: values[rows] for name, values in observation.items()}, action[: length - 1], index >= first)
