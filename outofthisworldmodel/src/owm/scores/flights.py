"""Recorded flights as arrays, and what they score."""

import csv
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from owm.scores.statistics import quantiles_by, rate
from owm_envs.files import write_atomically
from owm_envs.station import HELD_OUT_PORTS, PORT_NAMES, TRAIN_PORTS, goal_poses
from owm_envs.view import View

TOLERANCES: tuple[float, ...] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""m; with and without the bounds on speed, attitude and rate they make fourteen definitions of success."""
OUTCOMES: tuple[str, ...] = ("docked", "escaped", "timeout", "invalid_action", "diverged")
"""What may end a scored flight: evaluation records a collision and flies on."""
RANGES: tuple[float, ...] = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""m to the hold pose, between which speeds are pooled."""


_NEAR_AND_FAR = ("instants_far", "instants_far_safe", "instants_avoidable")


class ContactLimits(NamedTuple):
    """What a port asks of a vehicle at contact: m/s, m, rad, rad/s."""

    least_closing: float
    closing: float
    lateral_speed: float
    lateral: float
    attitude: float
    rate: float


IDSS = ContactLimits(0.05, 0.10, 0.04, 0.10, math.radians(4.0), math.radians(0.20))
"""Initial contact conditions. Source: International Docking System Standard, interface definition document."""


@dataclass(frozen=True)
class Flights:
    """N flights of one policy, from the truth at 20 Hz unless said otherwise; SI units, station frame."""

    policy: str
    port: Int[np.ndarray, "N"]
    """Index into `owm_envs.station.PORTS`."""
    seed: Int[np.ndarray, "N"]
    digest: np.ndarray
    """(N,) fingerprint of the true initial state."""
    outcome: np.ndarray
    """(N,) one of `OUTCOMES`."""
    collided: Bool[np.ndarray, "N"]
    """Whether the hull was ever touched."""
    closest_distance: Float[np.ndarray, "N"]
    closest_speed: Float[np.ndarray, "N"]
    closest_attitude: Float[np.ndarray, "N"]
    closest_rate: Float[np.ndarray, "N"]
    closest_time: Float[np.ndarray, "N"]
    """Errors to the goal pose at the closest approach and when it was: m, m/s, rad, rad/s, s."""
    closest_axial: Float[np.ndarray, "N"]
    closest_lateral: Float[np.ndarray, "N"]
    closest_closing: Float[np.ndarray, "N"]
    closest_lateral_speed: Float[np.ndarray, "N"]
    """The same position and velocity split along and across the port's normal: m, outwards positive; m; m/s, inwards
    positive; m/s."""
    clearance: Float[np.ndarray, "N"]
    """Least distance of the bounding sphere to the hull, m, at or below zero on contact."""
    time: Float[np.ndarray, "N"]
    """Flown, s."""
    delta_v: Float[np.ndarray, "N"]
    """Commanded: the integral of force over mass, m/s."""
    angular_impulse: Float[np.ndarray, "N"]
    """Commanded: the integral of torque, N m s."""
    decision_seconds: float
    """Wall time of one decision of one flight, compilation left out."""
    decision_dt: float
    bounds: tuple[float, float, float]
    """Speed m/s, attitude rad and rate rad/s that the full definitions demand."""
    trajectory: Float[np.ndarray, "N T+1 13"] | None = field(default=None, repr=False)
    """True relative view at each decision, float32, NaN after the end."""
    instants: Int[np.ndarray, "N"] | None = None
    instants_safe: Int[np.ndarray, "N"] | None = None
    """Instants 2 s apart, and those of them from which coasting stays clear of the hull (`coasting.add_coasts`)."""
    instants_far: Int[np.ndarray, "N"] | None = None
    instants_far_safe: Int[np.ndarray, "N"] | None = None
    """Those beyond 10 m of the hull, and those of them that are clear."""
    instants_avoidable: Int[np.ndarray, "N"] | None = None
    """Those nearer from which an impulse of at most 1 m/s leads clear, whichever one of six directions fails."""

    def __len__(self) -> int:
        return len(self.port)

    @property
    def starts_digest(self) -> str:
        """One fingerprint of all starts: equal when two policies flew the same ones, in whatever order."""
        return sha256("".join(sorted(self.digest.tolist())).encode()).hexdigest()[:16]

    def select(self, mask: Any) -> "Flights":
        """The flights of a mask or index."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return Flights(**{k: v[mask] if isinstance(v, np.ndarray) else v for k, v in values.items()})

    def rows(self) -> list[dict[str, Any]]:
        """One mapping per flight, angles in degrees and named so, for tables and CSV."""
        return [
            {
                "policy": self.policy,
                "port": PORT_NAMES[self.port[i]],
                "seed": int(self.seed[i]),
                "outcome": str(self.outcome[i]),
                "collided": bool(self.collided[i]),
                "closest_distance": float(self.closest_distance[i]),
                "closest_speed": float(self.closest_speed[i]),
                "closest_attitude_deg": math.degrees(self.closest_attitude[i]),
                "closest_rate_deg": math.degrees(self.closest_rate[i]),
                "closest_time": float(self.closest_time[i]),
                "closest_axial": float(self.closest_axial[i]),
                "closest_lateral": float(self.closest_lateral[i]),
                "closest_closing": float(self.closest_closing[i]),
                "closest_lateral_speed": float(self.closest_lateral_speed[i]),
                "clearance": float(self.clearance[i]),
                "time": float(self.time[i]),
                "delta_v": float(self.delta_v[i]),
                "angular_impulse": float(self.angular_impulse[i]),
                "instants": "" if self.instants is None else int(self.instants[i]),
                "instants_safe": "" if self.instants_safe is None else int(self.instants_safe[i]),
                **{name: "" if getattr(self, name) is None else int(getattr(self, name)[i]) for name in _NEAR_AND_FAR},
                "digest": str(self.digest[i]),
            }
            for i in range(len(self))
        ]

    def save(self, path: str | os.PathLike) -> None:
        """Write every array to one `.npz` file, atomically."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}
        write_atomically(path, lambda file: np.savez_compressed(file, **values))

    @classmethod
    def load(cls, path: str | os.PathLike) -> "Flights":
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: no such file.
            ValueError: the file is something else or truncated.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                values = {name: file[name] for name in file.files}
            values["policy"] = str(values["policy"])
            for name in ("decision_seconds", "decision_dt"):
                values[name] = float(values[name])
            values["bounds"] = tuple(float(x) for x in values["bounds"])
            return cls(**values)
        except FileNotFoundError:
            raise
        except Exception as error:
            raise ValueError(f"{os.fspath(path)!r} does not hold flights: {error}") from None


def join(parts: Sequence[Flights]) -> Flights:
    """Flights of one policy, one batch after the other."""
    first = parts[0]
    values = {}
    for f in fields(first):
        pieces = [getattr(part, f.name) for part in parts]
        values[f.name] = np.concatenate(pieces) if isinstance(pieces[0], np.ndarray) else pieces[0]
    sizes = [len(part) for part in parts]
    values["decision_seconds"] = float(np.average([part.decision_seconds for part in parts], weights=sizes))
    return Flights(**values)


def succeeded(flights: Flights, tolerance: float, *, full: bool = False, voided: bool = True) -> Bool[np.ndarray, "N"]:
    """Whether each flight succeeded under one of the fourteen definitions.

    Args:
        tolerance: m, of the closest approach to the goal.
        full: speed, attitude and rate must be within `flights.bounds` there too.
        voided: a collision fails the flight.

    Source: paper, docking with in-distribution goals.
    """
    success = flights.closest_distance < tolerance
    if full:
        speed, attitude, rate = flights.bounds
        success = success & (flights.closest_speed < speed) & (flights.closest_attitude < attitude)
        success = success & (flights.closest_rate < rate)
    return success & ~flights.collided if voided else success


def within_contact_limits(flights: Flights, *, least_closing: bool = True) -> Bool[np.ndarray, "N"]:
    """Whether each flight, without a collision, was within the docking standard's limits at its closest approach.

    The hold pose stands for the mating plane, metres in front of it; it is taken as reached within 0.1 m along the
    normal. The bound on the whole angle and the whole rate is no wider than the standard's, which bounds roll apart.

    Args:
        least_closing: ask for the closing speed that latches need, too; without it slower is as good.
    """
    limits = IDSS
    closing = flights.closest_closing
    met = (np.abs(flights.closest_axial) <= limits.lateral) & (flights.closest_lateral <= limits.lateral)
    met &= (closing <= limits.closing) & (flights.closest_lateral_speed <= limits.lateral_speed)
    met &= (flights.closest_attitude <= limits.attitude) & (flights.closest_rate <= limits.rate)
    met &= closing >= limits.least_closing if least_closing else closing >= 0
    return met & ~flights.collided


def safe_share(flights: Flights) -> float | None:
    """Share of all instants from which coasting stays clear of the hull; None where it was not looked at."""
    return None if flights.instants is None else _share(flights.instants_safe, flights.instants)


def far_safe_share(flights: Flights) -> float | None:
    """The same of the instants beyond 10 m of the hull."""
    return None if flights.instants_far is None else _share(flights.instants_far_safe, flights.instants_far)


def avoidable_share(flights: Flights) -> float | None:
    """Share of the instants nearer than that from which a small impulse leads clear; None where not looked at."""
    if flights.instants_far is None:
        return None
    return _share(flights.instants_avoidable, flights.instants - flights.instants_far)


def _share(some: Int[np.ndarray, "N"], of: Int[np.ndarray, "N"]) -> float | None:
    return float(some.sum() / of.sum()) if of.sum() else None


def speed_by_range(flights: Flights, edges: Sequence[float] = RANGES) -> list[dict[str, float]]:
    """Quantiles of the speed, m/s, by range to the hold pose, m, over all decisions."""
    goals = goal_poses()[flights.port, :3]
    seen = View.of(flights.trajectory)
    distance, speed = np.linalg.norm(seen.position - goals[:, None], axis=-1), np.linalg.norm(seen.velocity, axis=-1)
    return quantiles_by(distance.ravel(), speed.ravel(), edges)


def score(flights: Flights) -> dict[str, Any]:
    """All rates and medians of some flights.

    Returns:
        `success`: one entry per definition, named like "1 m full voided"; `collision`, `escape`, `timeout`,
        `docked`, `idss`, `idss_or_slower`: rates as `rate` gives them; `median_time` s, `median_delta_v` m/s and
        `median_angular_impulse` N m s of flights within 1 m with no collision (None without any); `least_clearance`
        m; `safe_share`, `far_safe_share`, `avoidable_share` of instants (None where not looked at).
    """
    good = succeeded(flights, 1.0)
    return {
        "success": {
            definition_name(*kind): rate(succeeded(flights, kind[0], full=kind[1], voided=kind[2]))
            for kind in itertools.product(TOLERANCES, (False, True), (False, True))
        },
        "collision": rate(flights.collided),
        "escape": rate(flights.outcome == "escaped"),
        "timeout": rate(flights.outcome == "timeout"),
        "docked": rate(flights.outcome == "docked"),
        "idss": rate(within_contact_limits(flights)),
        "idss_or_slower": rate(within_contact_limits(flights, least_closing=False)),
        "median_time": float(np.median(flights.time[good])) if good.any() else None,
        "median_delta_v": float(np.median(flights.delta_v[good])) if good.any() else None,
        "median_angular_impulse": float(np.median(flights.angular_impulse[good])) if good.any() else None,
        "safe_share": safe_share(flights),
        "far_safe_share": far_safe_share(flights),
        "avoidable_share": avoidable_share(flights),
        "least_clearance": float(np.min(flights.clearance)) if len(flights) else None,
    }


def definition_name(tolerance: float, full: bool, voided: bool) -> str:
    """What `score` calls a definition of success."""
    return f"{tolerance:g} m {'full' if full else 'position'} {'voided' if voided else 'raw'}"


def score_groups(flights: Flights) -> dict[str, dict[str, Any]]:
    """`score` of all flights, of the train and of the held-out ports, and of each port flown."""
    names = np.array(PORT_NAMES)[flights.port]
    groups = {"all": np.ones(len(flights), bool)}
    groups["train"] = np.isin(names, TRAIN_PORTS)
    groups["held_out"] = np.isin(names, HELD_OUT_PORTS)
    groups |= {port: names == port for port in PORT_NAMES}
    return {name: score(flights.select(mask)) for name, mask in groups.items() if mask.any()}


def write_results(flights: Mapping[str, Flights], folder: str | os.PathLike) -> list[Path]:
    """Write `flights.csv`, a row a flight, and `scores.json`, `score_groups` of every policy."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    rows = [row for each in flights.values() for row in each.rows()]
    table, scores = folder / "flights.csv", folder / "scores.json"

    def write_table(file):
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)

    write_atomically(table, write_table, text=True)
    content = {
        name: {
            "starts": each.starts_digest,
            "flights": len(each),
            "decision_seconds": each.decision_seconds,
            "speed_by_range": None if each.trajectory is None else speed_by_range(each),
            "scores": score_groups(each),
        }
        for name, each in flights.items()
    }
    write_atomically(scores, lambda file: json.dump(content, file, indent=1), text=True)
    return [table, scores]
