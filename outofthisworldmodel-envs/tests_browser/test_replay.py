"""The page of a flight in a real browser: it draws, plays and scrubs. Run by `nox -s browser`, which finds Chromium."""

import os
import shutil

import cv2
import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from owm_envs import cli
from owm_envs.camera.lens import placed
from owm_envs.camera.views import camera
from owm_envs.datasets.writer import recording
from owm_envs.replay import recorded, save_page
from owm_envs.station import CHASER, PARTS
from owm_envs.station.geometry import bounds
from owm_envs.view import View

# Drawn by the processor: the machines that test have no graphics card.
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
NASTY = 'To </script><script>alert("x")</script> & back'
FRAMES = np.uint8(np.clip(np.arange(25) // 5 * 50, 0, 255))[:, None, None, None] * np.ones((1, 8, 8, 3), np.uint8)


@pytest.fixture(scope="module")
def chromium():
    """Starts browsers: the system's Chromium if there is one, else playwright's own."""
    names = ("chromium", "chromium-browser", "google-chrome")
    found = os.environ.get("OWM_CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    with sync_playwright() as driver:
        yield lambda *flags: driver.chromium.launch(executable_path=found, args=["--no-sandbox", *flags])


class Opened:
    """A page, with what it said and asked for meanwhile."""

    def __init__(self, browser, file, width=1000, height=640):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.page.set_default_timeout(120_000)
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append((message.type, message.text)))
        self.page.on("pageerror", lambda error: self.said.append(("error", str(error))))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(file.as_uri())
        self.until("window.replay && replay.drawn > 0")

    def run(self, script):
        return self.page.evaluate(script)

    def until(self, condition):
        """Wait for what the page itself can tell: its policy lets nobody evaluate text in it later on."""
        look = f"const look = () => ({condition}) ? done() : requestAnimationFrame(look); look();"
        self.run(f"new Promise((done) => {{ {look} }})")

    def drawn(self):
        """Let the page draw what it was told, and give the picture of the stage."""
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        data = self.page.locator("#stage").screenshot()
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(float)

    def chaser(self):
        return np.array(self.run("[...replay.stage.world.chaser.position, ...replay.stage.world.chaser.quaternion]"))


@pytest.fixture(scope="module")
def episode(swoop):
    return swoop(24)


@pytest.fixture(scope="module")
def opened(chromium, episode, slow_config, tmp_path_factory):
    """The page that the command made of a recorded flight."""
    folder = tmp_path_factory.mktemp("browser")
    with recording(folder / "run" / "episodes", slow_config) as writer:
        writer.write([episode])
    cli.main(["replay", str(folder / "run"), "--out", str(folder / "page.html")])
    browser = chromium(*SOFTWARE)
    yield Opened(browser, folder / "page.html")
    browser.close()


@pytest.fixture
def at_rest(opened):
    """The same page as it is when opened."""
    opened.run("replay.play(false); replay.mode('orbit'); replay.seek(0)")
    opened.run("for (const name of Object.keys(LAYERS)) replay.show(name, name !== 'hull')")
    opened.drawn()
    return opened


def pose(episode, time):
    """Position and attitude (scalar last) at a time, by a formula of our own."""
    row = min(int(time / 0.25), len(episode) - 1)
    share = time / 0.25 - row
    one, two = View.of(episode.true_state[row]), View.of(episode.true_state[row + 1])
    position = (1 - share) * one.position + share * two.position
    p, q = one.attitude, two.attitude * np.sign(one.attitude @ two.attitude)
    angle = np.arccos(np.clip(p @ q, -1, 1))
    between = (np.sin((1 - share) * angle) * p + np.sin(share * angle) * q) / np.sin(angle)
    return position, np.roll(between, -1)


def assert_chaser_at(opened, episode, time):
    there = opened.chaser()
    position, attitude = pose(episode, time)
    assert np.allclose(there[:3], position, atol=1e-4)
    assert abs(there[3:] @ attitude) == pytest.approx(1, abs=1e-6)


def test_it_draws_and_asks_nothing_of_the_network(at_rest):
    image = at_rest.drawn()
    assert image.std() > 15 and len(np.unique(image.reshape(-1, 3), axis=0)) > 500
    curves = at_rest.page.locator("#curves").screenshot()
    assert cv2.imdecode(np.frombuffer(curves, np.uint8), cv2.IMREAD_GRAYSCALE).std() > 5
    assert [kind for kind, _ in at_rest.said if kind in ("error", "warning")] == [], at_rest.said
    assert all(url.startswith(("file:", "data:")) for url in at_rest.asked)
    assert "y aft" in at_rest.page.locator("#frame").inner_text()
    assert at_rest.page.locator("dd.docked").inner_text() == "docked"


def test_it_plays_by_the_space_bar_and_stops_at_the_end(at_rest, episode):
    at_rest.page.select_option("#speed", "0.25")
    at_rest.page.keyboard.press("Space")
    at_rest.until("replay.time > 0.3")
    at_rest.page.keyboard.press("Space")
    at_rest.drawn()
    time = at_rest.run("replay.time")
    assert not at_rest.run("replay.playing") and 0.3 < time < 6
    assert_chaser_at(at_rest, episode, time)
    assert float(at_rest.page.input_value("#time")) == pytest.approx(time)
    at_rest.page.select_option("#speed", "50")
    at_rest.page.click("#play")
    at_rest.until("!replay.playing")
    assert at_rest.run("replay.time") == pytest.approx(6)


@pytest.mark.parametrize("time", [0.0, 1.3, 3.12, 6.0])
def test_scrubbing_puts_the_chaser_where_it_was(at_rest, episode, time):
    move = "(bar, time) => { bar.value = time; bar.dispatchEvent(new Event('input')); }"
    at_rest.page.locator("#time").evaluate(move, time)
    at_rest.drawn()
    assert_chaser_at(at_rest, episode, time)
    assert at_rest.page.locator("#clock").inner_text().startswith(f"{time:.2f}")


def test_a_curve_can_be_dragged(at_rest):
    box = at_rest.page.locator(".curve canvas").first.bounding_box()
    margin = at_rest.run("MARGIN")
    across = lambda share: box["x"] + margin + share * (box["width"] - margin)
    at_rest.page.mouse.move(across(0.1), box["y"] + 20)
    at_rest.page.mouse.down()
    at_rest.page.mouse.move(across(0.5), box["y"] + 20)
    at_rest.page.mouse.up()
    assert at_rest.run("replay.time") == pytest.approx(3.0, abs=0.05)
    at_rest.drawn()
    distance = at_rest.page.locator(".curve figcaption span").first.inner_text()
    assert float(distance) == pytest.approx(at_rest.run("replay.flight.value('distance', replay.time)"), rel=0.01)


def test_keys_step_from_instant_to_instant(at_rest):
    press, time = at_rest.page.keyboard.press, lambda: at_rest.run("replay.time")
    press("ArrowRight")
    press("ArrowRight")
    assert time() == 0.5
    press("ArrowLeft")
    assert time() == 0.25
    press("Shift+ArrowRight")
    assert time() == 5.25
    press("End")
    assert time() == 6.0
    press("Home")
    assert time() == 0.0
    for key, mode in enumerate(["orbit", "chase", "nose", "port"], 1):
        press(str(key))
        assert at_rest.run("replay.stage.mode") == mode
        assert at_rest.page.locator("#modes [aria-pressed=true]").inner_text() == mode


def test_cameras_stand_where_the_environments_do(at_rest, episode):
    row = 17
    at_rest.run(f"replay.seek(replay.flight.times[{row}])")
    for mode, name in (("chase", "chaser_isometric"), ("nose", "chaser_fpv"), ("port", "station_fpv")):
        at_rest.run(f"replay.mode('{mode}')")
        at_rest.drawn()
        told = at_rest.run(
            "(() => { const { fixed } = replay.stage; return { place: [...fixed.position], fov: fixed.fov, "
            "axes: [0, 1, 2].map((k) => [...new THREE.Vector3().setComponent(k, k === 2 ? -1 : 1)"
            ".applyQuaternion(fixed.quaternion)]) }; })()"
        )
        lens = camera(name, port="zvezda_aft")
        wanted = placed(lens, View.of(episode.true_state[row]))
        assert np.allclose(told["place"], wanted.position, atol=1e-3), mode
        # Columns: right, up, forward.
        assert np.allclose(np.transpose(told["axes"]), wanted.axes, atol=1e-4), mode
        assert told["fov"] == pytest.approx(np.degrees(float(lens.field)))


def test_switches_show_and_hide(at_rest):
    everything = at_rest.drawn()
    for name in ("station", "ports", "path"):
        at_rest.page.locator(f"#show-{name}").uncheck()
        without = at_rest.drawn()
        assert not at_rest.run(f"replay.stage.world.layers.{name}.visible")
        assert (np.abs(without - everything).max(axis=2) > 8).sum() > 100, name
        at_rest.page.locator(f"#show-{name}").check()
    at_rest.page.locator("#show-hull").check()
    assert at_rest.run("replay.stage.world.layers.hull.visible")
    assert (np.abs(at_rest.drawn() - everything).max(axis=2) > 8).sum() > 1000


def test_thrust_points_where_the_force_does(at_rest, episode):
    at_rest.run("replay.seek(2.0)")
    at_rest.drawn()
    along = at_rest.run("[...new THREE.Vector3(0, 1, 0).applyQuaternion(replay.stage.world.arrows[0].quaternion)]")
    w, x, y, z = episode.true_state[8, 6:10]
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    force = (np.eye(3) + 2 * w * skew + 2 * skew @ skew) @ episode.action[8, :3]
    assert np.allclose(along, force / np.linalg.norm(force), atol=1e-5)


def test_the_mesh_is_that_of_the_parts(at_rest):
    script = """(whose) => {
      const group = whose === "chaser" ? replay.stage.world.chaser : replay.stage.world.layers.station.children[0];
      return Object.fromEntries(group.children.map(({ name, geometry }) => {
        geometry.computeBoundingBox();
        return [name, [[...geometry.boundingBox.min], [...geometry.boundingBox.max]]];
      }));
    }"""
    for whose, parts in (("station", PARTS), ("chaser", CHASER)):
        drawn = at_rest.page.evaluate(script, whose)
        assert set(drawn) == {part.material for part in parts}
        for material, box in drawn.items():
            own = np.stack([bounds(part) for part in parts if part.material == material])
            exact = np.stack([own[:, 0].min(axis=0), own[:, 1].max(axis=0)])
            assert np.allclose(box, exact, atol=0.03), (whose, material)  # round ones have 32 sides


def test_the_nose_is_drawn_where_nothing_was_recorded(at_rest):
    at_rest.run("replay.seek(4.0)")
    at_rest.drawn()
    data = at_rest.page.locator("#nose").screenshot()
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE).std() > 5
    assert "drawn by this page" in at_rest.page.locator("#picture figcaption").inner_text()


def test_recorded_frames_follow_the_clock_and_text_stays_text(chromium, episode, swoop, slow_config, tmp_path):
    seeing = swoop(24, observation={**episode.observation, "pixels": FRAMES})
    save_page(tmp_path / "page.html", recorded(NASTY, seeing, slow_config))
    browser = chromium(*SOFTWARE)
    opened = Opened(browser, tmp_path / "page.html", width=500, height=800)
    assert opened.page.locator("h1").inner_text() == opened.page.title() == NASTY
    for time, shade in ((0.0, 0), (1.24, 0), (1.25, 50), (3.0, 100), (6.0, 200)):
        opened.run(f"replay.seek({time})")
        opened.drawn()
        opened.run("document.getElementById('shot').decode()")
        image = cv2.imdecode(np.frombuffer(opened.page.locator("#shot").screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert abs(float(image[: len(image) // 2].mean()) - shade) < 4, time
    # On a narrow screen all is one column, and nothing sticks out of it.
    assert opened.run("document.documentElement.scrollWidth") <= 500
    browser.close()


def test_without_webgl_it_says_so_and_shows_the_curves(chromium, episode, slow_config, tmp_path):
    save_page(tmp_path / "page.html", recorded("Blind", episode, slow_config))
    browser = chromium("--disable-gpu", "--disable-3d-apis")
    opened = Opened(browser, tmp_path / "page.html")
    assert "no WebGL" in opened.page.locator("#notice").inner_text()
    assert not opened.page.locator("#view").is_visible()
    before = opened.page.locator("#curves").screenshot()
    opened.page.keyboard.press("End")
    opened.drawn()
    after = opened.page.locator("#curves").screenshot()
    assert before != after and opened.run("replay.time") == 6.0
    assert cv2.imdecode(np.frombuffer(after, np.uint8), cv2.IMREAD_GRAYSCALE).std() > 5
    assert not [text for kind, text in opened.said if kind == "error" and "WebGL" not in text]
    browser.close()
