"""Frames a second of the first-person camera, beside brute force and beside Embree, which take turns.

    pip install embreex
    python benchmarks/render_throughput.py                     # the table
    python benchmarks/render_throughput.py --soak 100000       # memory over so many frames of 512x512
    python benchmarks/render_throughput.py --rollout 64        # share of a rollout's time with pixels at 4 Hz

The chaser is 50 m from the station's nearest part and looks at the station, from all sides. Ours shades, with shadows,
the Earth and the stars; so does "ours, black sky", but for these. Brute force is JAX as well: every ray against every
part, first hit and one ray to the Sun, no shading. Embree (C++ with SIMD instructions and a hierarchy of bounds) gets
the triangles of the exported mesh: first hit and one ray to the Sun, no shading; one process a core.
The last line is all figures as JSON.
"""

import argparse
import json
import multiprocessing
import operator
import os
import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from owm_envs.camera.lens import grid, placed, rays
from owm_envs.camera.render import render
from owm_envs.camera.scene import Scene, assembled, default_scene, noon
from owm_envs.camera.sky import load_sky
from owm_envs.camera.solids import FAR, Solids, crossing
from owm_envs.camera.vectors import onto, plus
from owm_envs.camera.views import aimed, camera
from owm_envs.station import PARTS, nearest_part
from owm_envs.view import View

AWAY = 50.0
RIVALS = ("black", "brute", "embree")
SUN = np.asarray(noon().sun, np.float64)


def views(count: int, seed: int = 0) -> View:
    """Chasers at `AWAY` from the station, each looking at some place on it."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    targets = rng.uniform(-1.0, 1.0, (count, 3)) * (15.0, 15.0, 3.0)
    reach = np.full(count, 60.0)
    for _ in range(30):  # out along each way until the nearest part is as far as asked for
        distance, _ = nearest_part(PARTS, reach[:, None] * ways)
        reach += AWAY - distance
    positions = reach[:, None] * ways
    attitudes = np.stack([aimed(p, t) for p, t in zip(positions, targets)])
    still = np.zeros((count, 3))
    return View(*(jnp.asarray(part, jnp.float32) for part in (positions, still, attitudes, still)))


def best_of(call: Callable[[], object], seconds: float) -> float:
    """Seconds of the quickest of several calls, the first not counted."""
    call()
    times, end = [], time.perf_counter() + seconds
    while not times or time.perf_counter() < end:
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def tumbling(count: int, rng: np.random.Generator) -> View:
    """Chasers 30 to 300 m from the station's middle that look anywhere."""
    ways, turns = rng.normal(size=(count, 3)), rng.normal(size=(count, 4))
    positions = rng.uniform(30.0, 300.0, (count, 1)) * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    still = np.zeros((count, 3))
    parts = positions, still, turns / np.linalg.norm(turns, axis=1, keepdims=True), still
    return View(*(jnp.asarray(part, jnp.float32) for part in parts))


def drawing(scene: Scene, side: int) -> Callable[[View], object]:
    """A program that draws a batch of frames."""
    eye = camera("chaser_fpv", height=side, width=side)
    picture = jax.jit(jax.vmap(lambda view, scene: render(scene, view, eye)["rgb"], (0, None)))
    return lambda some: jax.block_until_ready(picture(some, scene))


def ours(scene: Scene, side: int, batch: int) -> Callable[[], object]:
    """A batch of frames."""
    draw, some = drawing(scene, side), views(batch)
    return lambda: draw(some)


def brute_force(scene: Scene, side: int) -> Callable[[], object]:
    """A frame: which part each ray meets first, and whether the Sun sees it there."""
    eye = camera("chaser_fpv", height=side, width=side)
    sun = tuple(jnp.float32(c) for c in SUN)

    def meet(parts: Solids, origin, way, first: bool):
        def one(best, part):
            centre, turn, half, quadric = part
            start = onto(turn, tuple(o - c for o, c in zip(origin, centre)))
            found = crossing(start, onto(turn, way), tuple(half), tuple(quadric))
            hit = (found.enter <= found.leave) & ((found.enter > 0) if first else (found.leave > 0))
            return jnp.where(hit, jnp.minimum(best, found.enter), best), None

        best = jnp.full(np.broadcast_shapes(origin[0].shape, way[0].shape), FAR, jnp.float32)
        return jax.lax.scan(one, best, parts[:4])[0]

    @jax.jit
    def picture(view, scene):
        pose, parts = placed(eye, view), assembled(scene, view)
        cut = grid(eye)
        cast = rays(eye, pose, cut, jnp.arange((cut.across.shape[0] - 1) * (cut.down.shape[0] - 1)))
        distance = meet(parts, *cast, first=True)
        points = plus(plus(cast.origin, jnp.minimum(distance, 1e4), cast.way), 0.005, sun)
        return distance, meet(parts, points, tuple(jnp.broadcast_to(s, distance.shape) for s in sun), first=False)

    view = jax.tree.map(lambda part: part[0], views(1))
    return lambda: jax.block_until_ready(picture(view, scene))


def embree_frames(side: int, seconds: float) -> float:
    """Frames a second of Embree in one process: first hit, then a ray to the Sun from each."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    from owm_envs.station.mesh import export, load_triangles

    world = rtcore_scene.EmbreeScene()
    with tempfile.TemporaryDirectory() as folder:
        export(f"{folder}/station.glb", PARTS)
        TriangleMesh(world, load_triangles(f"{folder}/station.glb").astype(np.float32))
    eye = camera("chaser_fpv", height=side, width=side)
    cut = grid(eye)
    origins, ways = [], []
    for view in (View(*parts) for parts in zip(*views(4))):
        cast = rays(eye, placed(eye, view), cut, jnp.arange((cut.across.shape[0] - 1) ** 2))
        way = np.stack([np.asarray(w).ravel() for w in cast.way], axis=-1)
        ways.append(np.ascontiguousarray(way, np.float32))
        origins.append(
            np.broadcast_to(np.array([np.asarray(o).item() for o in cast.origin], np.float32), way.shape).copy()
        )
    turn = [0]

    def frame():
        origin, way = origins[turn[0] % 4], ways[turn[0] % 4]
        turn[0] += 1
        found = world.run(origin, way, query="INTERSECT", output=1)
        hit = found["geomID"] >= 0
        points = origin[hit] + found["tfar"][hit, None] * way[hit] + 0.005 * SUN.astype(np.float32)
        world.run(points, np.broadcast_to(SUN.astype(np.float32), points.shape).copy(), query="OCCLUDED")

    frame()
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        frame()
        count += 1
    return count / (time.perf_counter() - start)


def embree(side: int, seconds: float, cores: int) -> float:
    """Frames a second of Embree on all cores, a process each."""
    with multiprocessing.get_context("spawn").Pool(cores) as pool:
        pool.starmap(embree_frames, [(side, 0.2)] * cores)
        return sum(pool.starmap(embree_frames, [(side, seconds)] * cores))


def rollout_share(slots: int, console: Console) -> dict[str, float]:
    """Decisions a second of a compiled batch without pixels, and with them at 4 Hz."""
    from owm_envs.env import DockingEnv

    figures = {}
    for label, settings in (
        ("state", {}),
        ("state+pixels", {"observation": "state+pixels", "camera": {"width": 64, "height": 64, "every": 5}}),
    ):
        env = DockingEnv(fidelity="iss-hcw", **settings)
        with jax.enable_x64(True):
            params = env.default_params()
            keys = jax.random.split(jax.random.key(0), slots)

            @jax.jit
            def start(params, keys, env=env):
                return jax.vmap(lambda key: env.reset(params, key=key)[0])(keys)

            @jax.jit
            def fly(params, states, env=env):
                action = jnp.zeros(6, states.view.dtype)
                step = jax.vmap(lambda state: env.step(params, state, action))

                def decide(states, _):
                    states, result = step(states)
                    return states, jax.tree.map(lambda part: part.sum(), result.observation)

                return jax.lax.scan(decide, states, length=20)[0]

            states = start(params, keys)
            seconds = best_of(partial(lambda fly, *rest: jax.block_until_ready(fly(*rest)), fly, params, states), 4.0)
        figures[label] = 20 * slots / seconds
        console.print(f"{label:>13}: {figures[label]:,.0f} decisions/s in a batch of {slots}")
    share = 1.0 - figures["state+pixels"] / figures["state"]
    console.print(f"pixels take {100 * share:.1f} % of the time")
    return {**figures, "pixels_share": share}


def soak(frames: int, side: int, batch: int, scene: Scene, console: Console) -> dict[str, float]:
    """Memory after the first frames and after all, each frame another one of tumbling chasers."""
    draw, rng, page = drawing(scene, side), np.random.default_rng(0), resource.getpagesize() / 2**20
    now = lambda: int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * page

    for _ in range(20):
        draw(tumbling(batch, rng))
    first = most = now()
    start = time.perf_counter()
    calls = -(-frames // batch)
    for number in track(range(1, calls + 1), "drawing", console=console):
        draw(tumbling(batch, rng))
        if number % max(calls // 100, 1) == 0:
            most = max(most, now())
        if number % max(calls // 5, 1) == 0 or number == calls:
            drawn = f"{number * batch:7d} frames of {side}x{side}"
            console.print(f"{drawn}: {now():6.0f} MiB, {most:.0f} at most; {first:.0f} after the first {20 * batch}")
    seconds = time.perf_counter() - start
    return {"frames": frames, "first_mib": first, "most_mib": most, "last_mib": now(), "frames_per_s": frames / seconds}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="+", default=[64, 128, 512])
    parser.add_argument("--batches", type=int, nargs="+", default=[64, 16, 1], help="one for each side")
    parser.add_argument("--parts", type=int, nargs="+", default=[], help="also with so many of the parts, 64x64")
    parser.add_argument("--seconds", type=float, default=4.0, help="a measurement")
    parser.add_argument(
        "--soak", type=int, default=0, metavar="FRAMES", help="of the last size and batch, black sky, for memory"
    )
    parser.add_argument("--rollout", type=int, default=0, metavar="SLOTS")
    parser.add_argument("--skip", nargs="*", default=[], choices=["brute", "embree"])
    options = parser.parse_args()
    console, cores = Console(), os.cpu_count() or 1
    full, black = default_scene(sky=load_sky()), default_scene()
    figures: dict[str, object] = {"device": jax.devices()[0].device_kind, "cores": cores}
    if options.soak:
        figures["soak"] = soak(options.soak, options.sides[-1], options.batches[-1], black, console)
    if options.rollout:
        figures["rollout"] = rollout_share(options.rollout, console)
    if not (options.soak or options.rollout):
        table = Table("frame", "batch", "ours, frames/s", "ours, black sky", "brute force", f"Embree, {cores} cores")
        for side, batch in zip(options.sides, options.batches):
            row = {"ours": batch / best_of(ours(full, side, batch), options.seconds)}
            row["black"] = batch / best_of(ours(black, side, batch), options.seconds)
            if "brute" not in options.skip:
                row["brute"] = 1.0 / best_of(brute_force(black, side), options.seconds)
            if "embree" not in options.skip:
                row["embree"] = embree(side, options.seconds, cores)
            beside = [f"{row[n]:,.1f} ({row['ours'] / row[n]:.2f}x)" if n in row else "-" for n in RIVALS]
            table.add_row(f"{side}x{side}", str(batch), f"{row['ours']:,.1f}", *beside)
            figures[f"{side}"] = row
        for count in options.parts:
            station = jax.tree.map(operator.itemgetter(slice(count)), black.station)
            rate = 64 / best_of(ours(black._replace(station=station), 64, 64), options.seconds)
            figures[f"parts_{count}"] = rate
            console.print(f"{count} of the station's parts, 64x64, black sky: {rate:,.0f} frames/s")
        console.print(table)
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
