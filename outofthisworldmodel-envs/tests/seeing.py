"""What a small recording with video is made of; the fixture `seeing` records it once a session."""

from owm_envs.config import load_config
from owm_envs.datasets.recipe import Request

CONFIG = load_config(
    fidelity="iss",
    horizon=1.0,
    steps_per_action=5,
    ports=["zvezda_aft", "unity_nadir"],
    observation="state+pixels",
    camera={"width": 16, "height": 16, "every": 2, "lamp": 20.0, "sky": False},
)
REQUEST = Request(transitions=60, val_transitions=8, seed=5, episodes_per_batch=8)
