"""Spacecraft docking at the International Space Station at three fidelities.

`import owm_envs` registers the Gymnasium ids `ISS-v0`, `ISSHCW-v0`, `ISSNumerical-v0` and the short names `iss`,
`iss-hcw`, `iss-numerical`, once Gymnasium is imported. By itself it imports neither that nor JAX.
"""

from owm_envs.registration import register_with_gymnasium

__version__ = "0.1.0"

register_with_gymnasium()
