"""Cores are shared out, as far as they can be named."""

import os

from owm_envs import cores


def test_processes_share_the_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 3, 5, 7}, raising=False)
    assert cores.core_count() == 4
    assert cores.core_shares(2) == [[2, 3], [5, 7]]
    assert cores.core_shares(5) == [[2], [3], [5], [7], [2, 3, 5, 7]]
    monkeypatch.delattr(os, "sched_getaffinity")
    assert cores.core_shares(2) == [[], []]
    assert cores.core_count() == os.cpu_count()
