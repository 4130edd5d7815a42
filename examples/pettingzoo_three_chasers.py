"""Fly three chasers to three ports at once: `python examples/pettingzoo_three_chasers.py [--video flight.mp4]`.

Each chaser is flown by the proportional pilot that follows the shortest way around the hull to its port, on what it
measures; it heeds the hull and not the other chasers, which its observation shows too. Prints what became of each and
draws the tracks. The way to a port is solved once and kept in the user's cache directory.

Needs `pip install pettingzoo matplotlib`.
"""

import argparse
from pathlib import Path

import numpy as np

from owm_envs.field import load_field
from owm_envs.pettingzoo import parallel_env
from owm_envs.policies import VectorPolicy, make_policy
from owm_envs.station import hull_boxes
from owm_envs.view import View


def fly(env, policy: VectorPolicy, ports: list[str], seed: int, every: int) -> tuple[dict, dict, list]:
    """Fly until the last chaser has ended: final infos, tracks (T, 3) by agent, pictures every `every` decisions."""
    observations, infos = env.reset(seed=seed, options={"dock_ports": ports})
    policy.reset(ports=ports)
    tracks = {agent: [View.of(info["true_state"]).position] for agent, info in infos.items()}
    own = env.layout.own.size  # the pilot sees what a lone chaser sees
    seen = np.stack([observations[agent][:own] for agent in env.possible_agents])
    pictures, decisions = [], 0
    while env.agents:
        actions, _ = policy.predict(seen)
        observations, _, _, _, after = env.step(dict(zip(env.possible_agents, actions)))
        infos.update(after)
        for agent, observation in observations.items():
            seen[env.possible_agents.index(agent)] = observation[:own]
            tracks[agent].append(View.of(after[agent]["true_state"]).position)
        if decisions % every == 0 and env.render_mode is not None:
            pictures.append(env.render())
        decisions += 1
    return infos, {agent: np.array(track) for agent, track in tracks.items()}, pictures


def report(infos: dict) -> None:
    print(f"{'agent':<10} {'port':<16} {'outcome':<9} {'time s':>7} {'closest':>9} {'hull':>8} {'others':>8}")
    for agent, info in infos.items():
        print(
            f"{agent:<10} {info['port']:<16} {info['outcome']:<9} {info['closest_time']:7.1f} "
            f"{info['closest_distance']:7.3f} m {info['clearance']:6.2f} m {info['separation']:6.2f} m"
        )


def plot(infos: dict, tracks: dict, file: Path) -> None:
    """The station from above and from the side, with the tracks."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import PolyCollection

    # Columns drawn across and up; forward is -y, to the right in both.
    views = {"from zenith": (1, 0, "port m"), "from starboard": (1, 2, "zenith m")}
    low, high = hull_boxes()[:, 0], hull_boxes()[:, 1]
    everything = np.concatenate([low, high, *tracks.values()])
    least, most = np.min(everything, axis=0) - 10, np.max(everything, axis=0) + 10
    heights = [most[up] - least[up] for _, up, _ in views.values()]
    tall = 0.5 + 8 * sum(heights) / (most[1] - least[1])  # the same scale in both
    figure, panels = plt.subplots(2, 1, figsize=(9, tall + 1), height_ratios=heights, layout="constrained")
    for panel, (title, (across, up, label)) in zip(panels, views.items()):
        corners = [(low, low), (high, low), (high, high), (low, high)]
        outlines = np.stack([np.stack([-a[:, across], b[:, up]], axis=1) for a, b in corners], axis=1)
        panel.add_collection(PolyCollection(outlines, facecolor="0.82", edgecolor="0.62", linewidth=0.4))
        for number, (agent, track) in enumerate(tracks.items()):
            x, y = -track[:, across], track[:, up]
            name = f"{agent}: {infos[agent]['port']}, {infos[agent]['outcome']}"
            panel.plot(x, y, color=f"C{number}", linewidth=1.6, label=name)
            panel.plot(x[0], y[0], "o", color=f"C{number}", markersize=5, markerfacecolor="white")
            panel.add_patch(plt.Circle((x[-1], y[-1]), 2.25, color=f"C{number}", zorder=3))
        limits = {"xlim": (-most[across], -least[across]), "ylim": (least[up], most[up])}
        panel.set(title=title, ylabel=label, aspect="equal", **limits)
        panel.grid(color="0.93")
        panel.set_axisbelow(True)
    panels[-1].set_xlabel("forward m")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(tracks), frameon=False)
    figure.savefig(file, dpi=130)


def write_video(pictures: list, file: Path, rate: float) -> None:
    import cv2

    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*"mp4v"), rate, (width, height))
    for picture in pictures:
        writer.write(picture[..., ::-1])
    writer.release()


def main() -> None:
    """Fly, report, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fidelity", default="iss-numerical")
    parser.add_argument("--ports", nargs=3, default=["harmony_zenith", "zvezda_aft", "rassvet_nadir"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/three_chasers.png"))
    parser.add_argument("--video", type=Path, help="also write the flight here, ten times as fast as it was (MP4)")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)

    env = parallel_env(
        num_chasers=3,
        fidelity=options.fidelity,
        noise="cooperative",
        steps_per_action=5,
        render_mode="rgb_array" if options.video else None,
    )
    pilot = make_policy("dock-geodesic", env.fleet_env.docking, geodesic_field=load_field(options.ports))
    infos, tracks, pictures = fly(env, VectorPolicy(pilot), options.ports, options.seed, every=2)
    report(infos)
    plot(infos, tracks, options.out)
    print(f"wrote {options.out}")
    if options.video:
        options.video.parent.mkdir(parents=True, exist_ok=True)
        write_video(pictures, options.video, rate=10 / (2 * env.config.decision_dt))
        print(f"wrote {options.video}")


if __name__ == "__main__":
    main()
