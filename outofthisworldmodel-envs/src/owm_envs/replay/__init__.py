"""One recorded flight to look at: a page that needs nothing else, or a recording for Rerun."""

from owm_envs.replay.page import save_page
from owm_envs.replay.recording import Pictures, Recording, film, load, recorded
from owm_envs.replay.rrd import save_rrd

__all__ = ["Pictures", "Recording", "film", "load", "recorded", "save_page", "save_rrd"]
