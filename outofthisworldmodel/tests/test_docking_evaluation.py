import math
from dataclasses import replace

import numpy as np
import pytest

from owm.report.plots import hull_distance, tolerance_figure, trajectory_figure
from owm.report.tables import definitions_table, docking_table, failures, port_table
from owm.scores.docking import (
    check_identical_starts,
    evaluation_config,
    fly_episodes,
    start_digest,
    state_at,
    trials,
)
from owm.scores.flights import (
    TOLERANCES,
    Flights,
    definition_name,
    score,
    score_groups,
    succeeded,
    within_contact_limits,
    write_results,
)
from owm.scores.statistics import rate
from owm_envs.adapters.gymnasium import DockingVectorEnv
from owm_envs.env import DockingEnv
from owm_envs.figures import save_figure
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.station import PORT_NAMES, goal_poses, hull_boxes

PORTS = ["harmony_nadir", "unity_nadir"]
# A box about both goals: every flight touches it, none may end by it.
BLOCK = ((-4.0, -20.0, -16.0), (4.0, 4.0, -8.0))


@pytest.fixture(scope="module")
def config():
    return evaluation_config(fidelity="iss", precision="float32", obstacles=(BLOCK,))


def scripted(name, config, seed=0):
    return VectorPolicy(make_policy(name, DockingEnv(config)), seed=seed)


@pytest.fixture(scope="module")
def docked(config):
    seeds, ports = trials(PORTS, 2)
    return fly_episodes(scripted("dock", config), config, seeds, ports)


def test_flights_dock_and_record_the_collision_without_ending(docked):
    assert docked.outcome.tolist() == ["docked"] * 4
    assert docked.collided.all() and (docked.clearance <= 0).all()
    assert (docked.closest_distance < 0.1).all() and (docked.closest_speed < 0.5).all()
    assert not succeeded(docked, 10.0).any() and succeeded(docked, 0.1, full=True, voided=False).all()
    assert np.all(docked.delta_v > 1.0) and np.all(docked.decision_seconds > 0)


def test_trajectories_end_where_the_flight_ended(docked):
    for i in range(len(docked)):
        flown = ~np.isnan(docked.trajectory[i, :, 0])
        steps = int(flown.sum()) - 1
        assert flown[: steps + 1].all() and docked.time[i] == pytest.approx(steps * docked.decision_dt)
        start = np.linalg.norm(docked.trajectory[i, 0, :3])
        assert 100.0 <= start <= 225.0
        assert docked.closest_time[i] <= docked.time[i] + 0.05  # float32 clock


def test_every_policy_flies_the_same_starts_and_other_trials_others(config, docked):
    seeds, ports = trials(PORTS, 2)
    drifting = fly_episodes(scripted("random", config), config, seeds, ports, record=False)
    assert check_identical_starts([docked, drifting]) == docked.starts_digest
    assert len(set(docked.digest.tolist())) == 4
    assert drifting.trajectory is None
    other = docked.select(slice(0, 2))
    with pytest.raises(ValueError, match="same starts"):
        check_identical_starts([docked, other])


def test_seeds_depend_on_port_and_trial_alone():
    seeds, ports = trials(PORT_NAMES, 3)
    again, again_ports = trials(["zvezda_aft"], 5)
    here = ports == PORT_NAMES.index("zvezda_aft")
    assert set(seeds[here]) == set(again[:3]) and set(again_ports) == {PORT_NAMES.index("zvezda_aft")}
    assert len(set(seeds)) == len(seeds)
    assert not set(trials(PORT_NAMES, 3, seed=1)[0]) & set(seeds)


def test_flights_in_several_batches_are_those_of_one(config, docked):
    seeds, ports = trials(PORTS, 3)
    told, batches = [], []
    parts = fly_episodes(
        scripted("dock", config), config, seeds, ports, lambda *now: told.append(now), slots=4, keep=batches.append
    )
    assert len(parts) == 6 and len(set(parts.digest)) == 6
    same = parts.select(np.array([0, 1, 3, 4]))
    assert same.digest.tolist() == docked.digest.tolist()
    np.testing.assert_allclose(same.closest_distance, docked.closest_distance, atol=1e-3)
    assert {first for first, *_ in told} == {0, 4}
    # The recordings are those of the flights: what was true, done, and came of it.
    assert [len(batch) for batch in batches] == [4, 2]
    for number, episode in enumerate([*batches[0], *batches[1]]):
        flown = parts.trajectory[number][np.isfinite(parts.trajectory[number, :, 0])]
        np.testing.assert_array_equal(episode.true_state.astype(np.float32), flown)
        force = np.linalg.norm(episode.action[:, :3].astype(float), axis=1)
        assert force.sum() * parts.decision_dt / config.chaser.mass == pytest.approx(parts.delta_v[number], rel=1e-5)
        assert (episode.outcome_name, episode.policy_name, episode.port) == ("docked", "dock", parts.port[number])
        noise = episode.observation["state"] - episode.true_state
        assert 0.01 < np.linalg.norm(noise[:, :3], axis=1).mean() < 0.1
        assert len(episode.epoch) == len(flown) and episode.done[-1] and not episode.done[:-1].any()


class Recorder:
    """Flies another policy and keeps what it was shown and did."""

    name = "recorder"

    def __init__(self, policy):
        self.policy, self.seen = policy, []

    def reset(self, mask, ports):
        self.policy.reset(mask, ports)

    def predict(self, observation, state, episode_start, deterministic):
        action, state = self.policy.predict(observation, state, episode_start, deterministic)
        self.seen.append((observation.copy(), np.array(action)))
        return action, state


def test_a_policy_does_the_same_when_the_truth_in_info_is_gone(config, monkeypatch):
    seeds, ports = trials(PORTS, 2)
    honest, blinded = Recorder(scripted("dock", config)), Recorder(scripted("dock", config))
    fly_episodes(honest, config, seeds, ports, record=False)

    def without_truth(method):
        def called(*args, **kwargs):
            *rest, info = method(*args, **kwargs)
            gone = {k: np.full_like(v, np.nan) for k, v in info.items() if np.issubdtype(v.dtype, np.floating)}
            return *rest, {**info, **gone}

        return called

    monkeypatch.setattr(DockingVectorEnv, "reset", without_truth(DockingVectorEnv.reset))
    monkeypatch.setattr(DockingVectorEnv, "step", without_truth(DockingVectorEnv.step))
    flown = fly_episodes(blinded, config, seeds, ports, record=False)
    assert np.isnan(flown.closest_distance).all()
    assert len(honest.seen) == len(blinded.seen) > 900
    for one, other in zip(honest.seen, blinded.seen):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


class Constant:
    """Commands one action for ever."""

    def __init__(self, action):
        self.action = np.asarray(action)
        self.active = None

    def reset(self, mask, ports):
        pass

    def predict(self, observation, state, episode_start, deterministic):
        return np.broadcast_to(self.action, (len(observation), *self.action.shape)), None


def test_an_action_that_is_not_finite_ends_the_flight_as_such(config):
    seeds, ports = trials(PORTS, 2)
    flown = fly_episodes(Constant([np.nan] * 6), config, seeds, ports)
    assert flown.outcome.tolist() == ["invalid_action"] * 4 and (flown.delta_v == 0).all()


def test_a_policy_with_active_is_told_which_flights_go_on(config):
    policy = Constant([1600.0, 0, 0, 0, 0, 0])
    seeds, ports = trials(PORTS, 2)
    flown = fly_episodes(policy, config, seeds, ports, record=False)
    assert flown.outcome.tolist() == ["escaped"] * 4
    assert policy.active.shape == (4,) and not policy.active.any()
    # Full thrust along one axis: 1600 N / 12 t.
    np.testing.assert_allclose(flown.delta_v, flown.time * 1600 / 12_000, rtol=1e-6)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda c: evaluation_config("90-100"), "unknown shell"),
        (lambda c: trials(["zvezda"], 1), "zvezda_aft"),
        (lambda c: trials(PORTS, 0), "got 0"),
        (lambda c: fly_episodes(Constant([0.0] * 5), c, *trials(PORTS, 2)), r"\(4, 6\), got \(4, 5\)"),
        (lambda c: fly_episodes(Constant([0.0] * 6), c, np.arange(2), np.arange(3)), r"\(2,\) and \(3,\)"),
    ],
)
def test_mistakes_are_named(config, call, message):
    with pytest.raises(ValueError, match=message):
        call(config)


def made(distance, collided, outcome="timeout", speed=0.1, port=None):
    count = len(distance)
    zeros = np.zeros(count)
    return Flights(
        policy="made",
        port=np.arange(count, dtype=np.int32) % 8 if port is None else np.asarray(port),
        seed=np.arange(count),
        digest=np.array([f"{i}" for i in range(count)]),
        outcome=np.array([outcome] * count),
        collided=np.asarray(collided),
        closest_distance=np.asarray(distance),
        closest_speed=zeros + speed,
        closest_attitude=zeros,
        closest_rate=zeros,
        closest_time=zeros,
        closest_axial=np.asarray(distance),
        closest_lateral=zeros,
        closest_closing=zeros + speed,
        closest_lateral_speed=zeros,
        clearance=zeros + 1,
        time=np.arange(count) + 100.0,
        delta_v=zeros + 2,
        angular_impulse=zeros,
        decision_seconds=0.01,
        decision_dt=0.25,
        bounds=(0.5, math.radians(5), math.radians(0.5)),
    )


def test_the_fourteen_definitions():
    flights = made([0.05, 0.3, 0.9, 3.0, 20.0], [False, True, False, False, False])
    expected = {0.1: (1, 1), 0.2: (1, 1), 0.5: (2, 1), 1.0: (3, 2), 2.0: (3, 2), 5.0: (4, 3), 10.0: (4, 3)}
    scores = score(flights)
    assert len(scores["success"]) == 2 * 14
    for tolerance, (raw, voided) in expected.items():
        assert scores["success"][definition_name(tolerance, False, False)]["count"] == raw
        assert scores["success"][definition_name(tolerance, True, True)]["count"] == voided
    assert scores["collision"]["rate"] == pytest.approx(0.2) and scores["timeout"]["rate"] == 1.0
    assert scores["median_time"] == pytest.approx(101.0)  # of the first and the third
    fast = score(made([0.05], [False], speed=0.6))["success"]
    assert fast["0.1 m position voided"]["count"] == 1 and fast["0.1 m full voided"]["count"] == 0
    assert set(TOLERANCES) == set(expected)


def test_groups_pool_train_and_held_out_ports():
    flights = made([0.5] * 8, [False, True] * 4)
    groups = score_groups(flights)
    assert groups["all"]["collision"] == rate(flights.collided)
    assert groups["train"]["collision"]["total"] == 5 and groups["held_out"]["collision"]["total"] == 3
    assert groups["harmony_zenith"]["collision"]["count"] == 1
    only = score_groups(made([0.5], [False], port=[3]))
    assert "held_out" not in only and set(only) == {"all", "train", "zvezda_aft"}


def test_the_closest_approach_is_split_along_the_ports_normal(docked):
    split = np.hypot(docked.closest_axial, docked.closest_lateral)
    np.testing.assert_allclose(split, docked.closest_distance, atol=2e-4)
    split = np.hypot(docked.closest_closing, docked.closest_lateral_speed)
    np.testing.assert_allclose(split, docked.closest_speed, atol=2e-3)  # float32 clock
    # Both ports face nadir: outwards is down, closing is up. These flights were closest when they ended.
    last = docked.trajectory[np.arange(4), np.isfinite(docked.trajectory[..., 0]).sum(axis=1) - 1]
    np.testing.assert_allclose(docked.closest_axial, goal_poses()[docked.port, 2] - last[:, 2], atol=5e-4)
    np.testing.assert_allclose(docked.closest_closing, last[:, 5], atol=5e-4)


def test_states_between_samples_follow_a_steady_acceleration():
    position, velocity, acceleration = np.array([1.0, 2, 3]), np.array([0.1, -0.2, 0.3]), np.array([0.2, 0.1, -0.1])
    clock = np.array([[0.0, 0.25, 0.5, np.nan], [0.0, 0.25, 0.35, np.nan]])

    def at(t):
        moved = position + velocity * t[..., None] + 0.5 * acceleration * t[..., None] ** 2
        return np.concatenate([moved, velocity + acceleration * t[..., None]], axis=-1)

    path = np.concatenate([at(clock), np.zeros((2, 4, 7))], axis=2)
    for times in ([0.1, 0.3], [0.0, 0.35], [0.5, 0.25]):
        np.testing.assert_allclose(state_at(path, clock, np.array(times)), at(np.array(times)), atol=1e-12)


def test_contact_limits_of_the_docking_standard():
    flights = made([0.05] * 6, [False] * 5 + [True])
    flights = replace(flights, closest_closing=np.array([0.07, 0.03, 0.12, -0.01, 0.07, 0.07]))
    flights = replace(flights, closest_lateral_speed=np.array([0.0, 0, 0, 0, 0.05, 0]))
    assert within_contact_limits(flights).tolist() == [True, False, False, False, False, False]
    assert within_contact_limits(flights, least_closing=False).tolist() == [True, True] + [False] * 4
    assert not within_contact_limits(replace(flights, closest_lateral=np.full(6, 0.11))).any()
    assert score(flights)["idss"]["count"] == 1


def test_flights_survive_their_file_and_a_broken_one_is_named(docked, tmp_path):
    docked.save(tmp_path / "flights.npz")
    back = Flights.load(tmp_path / "flights.npz")
    assert back.rows() == docked.rows() and back.bounds == docked.bounds
    np.testing.assert_array_equal(back.trajectory, docked.trajectory)
    whole = (tmp_path / "flights.npz").read_bytes()
    (tmp_path / "flights.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="does not hold flights"):
        Flights.load(tmp_path / "flights.npz")
    with pytest.raises(FileNotFoundError):
        Flights.load(tmp_path / "none.npz")


def test_results_tables_and_pictures(docked, tmp_path):
    table, scores = write_results({"dock": docked}, tmp_path)
    assert len(table.read_text().splitlines()) == 5 and '"starts"' in scores.read_text()
    assert docking_table([docked]).rows[0][:5] == ["dock", "4", "0 % [0, 49]", "0 % [0, 49]", "100 %"]
    assert [row[0] for row in port_table([docked]).rows] == [
        "harmony_nadir",
        "unity_nadir (held out)",
        "train ports",
        "held-out ports",
        "all",
    ]
    assert definitions_table([docked]).rows[0][1] == "0 % (100 %)"
    assert len(failures([docked]).rows) == 4
    save_figure(trajectory_figure(docked), tmp_path / "a.png", dpi=40)
    save_figure(trajectory_figure(docked.select(slice(0, 1))), tmp_path / "b.png", dpi=40)
    save_figure(tolerance_figure([docked]), tmp_path / "c.png", dpi=40)
    for name in "abc":
        assert (tmp_path / f"{name}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert not list(tmp_path.glob(".*"))


def test_trajectories_show_every_start_and_the_station(docked):
    figure = trajectory_figure(docked)
    starts, hull = docked.trajectory[:, 0, :3], hull_boxes()
    whole, close = figure.axes[:3], figure.axes[3:6]
    for axes, closer, (i, j) in zip(whole, close, ((1, 2), (0, 2), (1, 0))):
        assert all(axes.viewLim.contains(*start[[i, j]]) for start in starts)
        assert all(closer.viewLim.contains(*corner[[i, j]]) for corner in hull.reshape(-1, 3))
        assert closer.viewLim.width < 1.2 * np.ptp(hull.reshape(-1, 3), axis=0).max()
    # One flight needs no second look.
    assert len(trajectory_figure(docked.select([0])).axes) == len(figure.axes) - 3


def test_tolerances_are_shown_where_flights_differ(docked):
    free = replace(docked, collided=np.array([False, False, False, True]))
    for axes, name in zip(tolerance_figure([free]).axes, ("distance", "speed", "attitude", "rate")):
        steps = axes.lines[0]
        errors = np.sort(getattr(free, f"closest_{name}")[:3]) * (np.degrees(1) if name in ("attitude", "rate") else 1)
        np.testing.assert_allclose(steps.get_xdata()[1:-1], errors)
        assert steps.get_ydata().tolist() == [0, 25, 50, 75, 75]


def test_hull_distance_agrees_with_the_simulation(docked):
    # The environment's clearance is swept and includes the extra box; outside that box's reach both agree.
    far = docked.trajectory[:, 0, :3]
    assert (hull_distance(far, 2.25) > 30).all()
    inside = np.array([0.233, 10.0, -1.87])
    assert hull_distance(inside, 2.25) == pytest.approx(-2.25)
    assert np.isnan(hull_distance(np.full(3, np.nan)))


def test_the_digest_of_a_start_tells_view_epoch_and_port():
    view, epoch = np.arange(13.0), np.array([60000.0, 12.5])
    digests = {
        start_digest(view, epoch, 3),
        start_digest(view + 1e-9, epoch, 3),
        start_digest(view, epoch + [0.0, 1e-6], 3),
        start_digest(view, epoch, 4),
    }
    assert len(digests) == 4 and start_digest(view.copy(), epoch, np.int32(3)) in digests
