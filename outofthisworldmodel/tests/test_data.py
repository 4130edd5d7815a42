"""Windows: rate, means, episode ends, quaternion signs, bad input."""

from types import SimpleNamespace

import numpy as np
import pytest

from owm.data.windows import from_episodes, history_of
from owm_envs.view import View


def recording(steps, *, base=0.0, padded=False):
    """An episode whose numbers tell where they came from."""
    state = np.zeros((steps + 1, 13), np.float32)
    state[:, 0] = base + np.arange(steps + 1)
    angle = 0.2 * np.arange(steps + 1)
    state[:, 6], state[:, 9] = np.cos(angle / 2), np.sin(angle / 2)
    state[::3, 6:10] *= -1.0
    action = np.repeat(np.arange(steps, dtype=np.float32)[:, None], 6, axis=1)
    if padded:
        action = np.concatenate([action, np.zeros((1, 6), np.float32)])
    return SimpleNamespace(observation={"state": state}, true_state=state + 1.0, action=action, policy="p", port="q")


def test_every_fifth_view_and_the_mean_of_five_actions():
    data = from_episodes([recording(23)])
    np.testing.assert_array_equal(data.view[:, 0], [0, 5, 10, 15, 20])
    np.testing.assert_array_equal(data.truth[:, 0], data.view[:, 0] + 1)
    np.testing.assert_array_equal(data.action[:, 0], [2, 7, 12, 17, 0])
    assert (data.steps, data.dt, data.policies, data.ports) == (4, 0.25, ("p",), ("q",))


def test_a_padded_last_action_is_dropped():
    a, b = from_episodes([recording(25)]), from_episodes([recording(25, padded=True)])
    np.testing.assert_array_equal(a.action, b.action)


def test_quaternions_are_continuous():
    q = View.of(from_episodes([recording(60)]).view).attitude
    assert (np.sum(q[1:] * q[:-1], axis=1) > 0).all()


@pytest.mark.parametrize("phases", [1, 5])
def test_windows_never_cross_an_episode_or_phase(phases):
    data = from_episodes([recording(40), recording(22, base=1000), recording(31, base=2000)], phases=phases)
    windows = data.windows(4)
    np.testing.assert_array_equal(np.diff(windows.observation["state"][:, :, 0], axis=1), 5.0)
    first = np.asarray(windows.observation["state"][:, :-1, 0]) % 1000
    np.testing.assert_array_equal(windows.action[:, :, 0], first + 2)
    expected = sum(max((n - p) // 5 + 1 - 3, 0) for n in (40, 22, 31) for p in range(phases))
    assert len(windows.action) == expected == len(data.starts(4))


def test_drawn_windows_are_distinct_and_repeatable():
    data = from_episodes([recording(200)])
    a, b = data.windows(4, 10, seed=3), data.windows(4, 10, seed=3)
    np.testing.assert_array_equal(a.observation["state"], b.observation["state"])
    assert len(np.unique(a.observation["state"][:, 0, 0])) == 10
    assert data.digest() == from_episodes([recording(200)]).digest() != from_episodes([recording(205)]).digest()


def test_short_histories_repeat_the_first_real_view():
    windows = from_episodes([recording(60)]).windows(8, 1)
    views = windows.observation["state"][0]
    history = history_of({"state": views}, windows.action[0], 6, 2)
    np.testing.assert_array_equal(history.valid, [False] * 4 + [True] * 2)
    np.testing.assert_array_equal(history.observation["state"][:5, 0], views[4, 0])
    np.testing.assert_array_equal(history.observation["state"][5], views[5])


def test_further_parts_go_with_the_views():
    one = recording(23)
    ranges = np.arange(24, dtype=np.int16)[:, None]
    one.observation["range"] = ranges
    data = from_episodes([one, one], phases=2)
    assert data.observation["range"].dtype == np.int16
    np.testing.assert_array_equal(data.observation["range"][:, 0], data.view[:, 0])
    windows = data.windows(3)
    np.testing.assert_array_equal(windows.observation["range"][..., 0], windows.observation["state"][..., 0])
    np.testing.assert_array_equal(windows.last(2).observation["range"], windows.observation["range"][:, 1:])
    history = history_of({name: part[0] for name, part in windows.observation.items()}, windows.action[0], 3, 2)
    np.testing.assert_array_equal(history.observation["range"][:, 0], history.observation["state"][:, 0])
    assert data.digest() != from_episodes([recording(23)] * 2, phases=2).digest()
    assert data.flown_by(["p"]).observation.keys() == {"state", "range"}
    with pytest.raises(ValueError, match="episode 1: parts must be state, range of 24 rows each"):
        from_episodes([one, recording(23)])


def test_bad_recordings_are_refused():
    good = recording(30)
    short = good.observation["state"][:, :12]
    for change, message in (
        ({"observation": {"state": short}, "true_state": short}, r"state part must be \(T \+ 1, 13\)"),
        ({"observation": {"range": short}}, r"state part must be \(T \+ 1, 13\), got \(0,\)"),
        ({"action": good.action[:20]}, r"action must be \(30, 6\), got \(20, 6\)"),
        ({"action": good.action * np.nan}, "must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            from_episodes([SimpleNamespace(**{**vars(good), **change})])
    with pytest.raises(ValueError, match="no episode holds a transition"):
        from_episodes([recording(3)])
    with pytest.raises(ValueError, match="phases must be 1 to 5"):
        from_episodes([good], phases=6)
    with pytest.raises(ValueError, match="the longest episode has 7"):
        from_episodes([good]).windows(8)
