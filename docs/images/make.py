"""Draw the README's pictures from a finished demo: `python docs/images/make.py [runs/demo]`."""

import sys
from pathlib import Path

import cv2
import numpy as np

from owm.scores.flights import Flights
from owm_envs.render.schematic import draw_schematic
from owm_envs.station import goal_poses, hull_boxes, port_index
from owm_envs.station.picture import draw_station

demo = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/demo")
here = Path(__file__).parent
flights = Flights.load(demo / "flights" / "world_model.npz")
port = port_index("poisk_zenith")
flight = int(np.flatnonzero(np.asarray(flights.port) == port)[0])
path = flights.trajectory[flight]
path = path[np.isfinite(path[:, 0])]
shown = len(path) - 60
lines = [
    "flown by   world model",
    f"t {shown * 0.25:.1f} s",
    f"to goal {np.linalg.norm(path[shown, :3] - goal_poses()[port, :3]):.2f} m",
    f"speed {np.linalg.norm(path[shown, 3:6]):.2f} m/s",
]
picture = draw_schematic(hull_boxes(), goal_poses(), path[shown], path[: shown + 1, :3], port, lines, size=(1280, 720))
cv2.imwrite(str(here / "approach.png"), picture[..., ::-1])
station = draw_station((1120, 700))
cv2.imwrite(str(here / "station.png"), station[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
