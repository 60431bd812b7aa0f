"""The real window on a virtual screen, driven by a mouse and keys, at several sizes."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from opengl import skip_or_fail
from oracles import ROOT
from program import DATA

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify

# Seconds that one effect may take on a busy machine without a graphics card.
PATIENCE = 120.0


@pytest.fixture
def display():
    """The name of a virtual screen."""
    missing = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
    if missing:
        skip_or_fail(f"{' and '.join(missing)} missing: apt-get install xvfb xdotool")
    reader, writer = os.pipe()
    # The server chooses a free number itself, and writes it when it is ready.
    command = ["Xvfb", "-displayfd", str(writer), "-screen", "0", "1920x1080x24"]
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.DEVNULL)
    server = subprocess.Popen(command, pass_fds=[writer], **streams)
    os.close(writer)
    with os.fdopen(reader) as answer:
        number = answer.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait(timeout=20)


class Session:
    """The real window on a virtual screen, driven by a mouse and keys; see window_program.py."""

    def __init__(self, display, folder, path, size):
        self.statusPath = folder / "status.json"
        self.environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, ROOT / "tests/window/window_program.py", path, self.statusPath]
        options = {"cwd": folder, "env": self.environment, "text": True}
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, **options)
        try:
            self.await_status(lambda status: "Play" in status["places"])
        except AssertionError as error:
            skip_or_fail(f"no window opens on the virtual screen: {error}")
        found = self.xdotool("search", "--sync", "--onlyvisible", "--name", "Rigid bodies")
        self.window = found.split()[0]
        self.resize(size)

    def resize(self, size):
        self.xdotool("windowmove", self.window, 0, 0)
        self.xdotool("windowsize", self.window, *size)
        self.await_status(lambda status: status["windowSize"] == list(size))
        # Keys go to the window that the mouse is over.
        self.move_to(size[0] / 2, size[1] / 2)

    def xdotool(self, *arguments):
        command, options = ["xdotool", *map(str, arguments)], {"text": True, "timeout": 60}
        done = subprocess.run(command, env=self.environment, capture_output=True, **options)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def status(self):
        return json.loads(self.statusPath.read_text())

    def await_status(self, isReached, patience=PATIENCE):
        """The status as soon as isReached(status); the window must live, and time not be up."""
        end = time.monotonic() + patience
        while time.monotonic() < end:
            assert self.process.poll() is None, self.process.stderr.read()
            if self.statusPath.exists() and isReached(status := self.status()):
                return status
            time.sleep(0.05)
        raise AssertionError(f"not within {patience} s: {self.status()}")

    def await_frame(self):
        """Waits until another frame has been drawn."""
        last = self.status()["frameCount"]
        self.await_status(lambda status: status["frameCount"] > last)

    def click_at(self, x, y):
        """A click that every frame sees: the button is down for at least two."""
        self.xdotool("mousemove", "--window", self.window, round(x), round(y))
        for action in ("mousedown", "mouseup"):
            self.await_frame()
            self.await_frame()
            self.xdotool(action, 1)
        self.await_frame()
        self.await_frame()

    def click(self, label, isReached=None, along=0.0):
        """Clicks a widget, `along` its width; over again until isReached(status), if given."""
        for _ in range(5):
            self.await_status(lambda status: label in status["places"])
            for _ in range(2):  # a list that opens is laid out in its first frames
                self.await_frame()
            places = self.await_status(lambda status: label in status["places"])["places"]
            x, y, width = places[label]
            self.click_at(x + along * width, y)
            if isReached is None:
                return self.status()
            try:
                return self.await_status(isReached, patience=PATIENCE / 10)
            except AssertionError:
                continue
        raise AssertionError(f"clicking {label} has no effect: {self.status()}")

    def key(self, name, isReached=None):
        """Presses a key; until isReached(status), if given."""
        self.xdotool("key", name)
        return self.await_status(isReached) if isReached else self.await_frame()

    def undo(self, isReached):
        """Presses Ctrl and Z, for as long as a person would."""
        self.xdotool("keydown", "ctrl")
        self.await_frame()
        self.key("z", isReached)
        self.xdotool("keyup", "ctrl")

    def move_to(self, x, y):
        self.xdotool("mousemove", "--window", self.window, round(x), round(y))
        self.await_frame()
        self.await_frame()

    def close(self):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.communicate(timeout=60)
        finally:
            self.process.kill()
            self.process.wait()


@pytest.fixture
def session(display, tmp_path):
    """Opens a Session on a path; it is closed at the end."""
    opened = []

    def open_session(path, size=(1000, 700)):
        opened.append(Session(display, tmp_path, path, size))
        return opened[-1]

    yield open_session
    for one in opened:
        one.close()


def test_a_session_in_the_window(session, tmp_path):
    window = session(DATA / "tower-scene.txt")
    window.click("Play", lambda status: status["isPlaying"])
    window.await_status(lambda status: status["step"] >= 5)
    # Friction, while it plays.
    status = window.click("friction", lambda status: status["friction"] > 0.1, along=0.2)
    assert status["isPlaying"] and status["frameRate"] == 60
    window.click("Pause", lambda status: not status["isPlaying"])
    before = window.status()["step"]
    window.click("Step", lambda status: status["step"] > before)
    # R keeps the settings; the button restores those of the scene.
    window.key("r", lambda status: status["step"] == 0)
    assert window.status()["friction"] > 0.1
    window.click("Step", lambda status: status["step"] > 0)
    # Restored by accident, they come back.
    window.click("Restore the scene's settings", lambda status: status["friction"] == 0.0)
    assert window.status()["step"] > 0
    window.undo(lambda status: status["friction"] > 0.1)
    window.click("×", lambda status: status["friction"] == 0.0, along=-0.6)
    window.key("shift+r", lambda status: status["step"] == 0)
    # A body is picked where it is seen, pushed and fixed.
    window.click_at(*window.status()["bodies"][1])
    status = window.await_status(lambda status: status["picked"] == 1)
    speed = status["velocity"][1]
    window.click("Up", lambda status: status["velocity"][1] > speed + 1.0)
    window.click("Fix", lambda status: status["isFixed"] and status["velocity"] == [0, 0, 0])
    window.click("Up")  # pushes no fixed body
    assert window.status()["changes"] == ["push", "fix"]
    window.click("Free", lambda status: not status["isFixed"])
    # An overlay, the plots and a picture.
    window.click("Simulation", lambda status: "friction" not in status["places"])
    window.click("contacts", lambda status: "contacts" in status["shown"])
    window.click("Display", lambda status: "contacts" not in status["places"])
    window.click("Plots")
    window.click("Step", lambda status: status["plotted"] > 0)
    window.click("Save", lambda status: "Picture" in status["places"])
    window.click("Picture", lambda status: status["saved"])
    (saved,) = (tmp_path / "out" / "tower").iterdir()
    assert saved.read_bytes()[:4] == b"\x89PNG"
    # Nobody does anything: few pictures a second, until the mouse moves.
    window.await_status(lambda status: status["frameRate"] < 10)
    window.xdotool("mousemove_relative", 5, 5)
    window.await_status(lambda status: status["frameRate"] == 60)
    window.close()
    assert window.process.returncode == 0


@pytest.mark.slow
def test_bodies_are_dragged_thrown_and_shot_and_the_recording_is_verified(session, tmp_path):
    window = session(DATA / "mixed-scene.txt")
    window.click("Simulation", lambda status: "friction" not in status["places"])
    window.click("Display", lambda status: "contacts" not in status["places"])
    window.click("Save", lambda status: "Record" in status["places"])
    window.click("Record", lambda status: status["recorded"])
    window.click("Play", lambda status: status["step"] > 3)
    body, begin = 3, window.status()
    window.key("space", lambda status: not status["isPlaying"])
    x, y = window.status()["bodies"][body]
    window.move_to(x, y)
    window.xdotool("keydown", "ctrl")
    window.await_frame()
    window.xdotool("mousedown", 1)
    window.await_status(lambda status: status["grabbed"] == body)
    window.xdotool("key", "space")
    window.await_status(lambda status: status["isPlaying"])
    for k in range(1, 9):
        window.move_to(x - 9 * k, y - 9 * k)
    # It hangs from the mouse while the others fall.
    status = window.await_status(
        lambda status: np.hypot(*np.subtract(status["bodies"][body], (x - 72, y - 72))) < 50
    )
    assert status["positions"][body][1] > begin["positions"][body][1]
    window.xdotool("mouseup", 1)
    window.xdotool("keyup", "ctrl")
    window.await_status(lambda status: status["grabbed"] is None)
    window.move_to(500, 360)
    window.key("b", lambda status: status["bodyCount"] == 16)
    last = window.status()["step"]
    window.await_status(lambda status: status["step"] > last + 10)
    window.click("Stop recording", lambda status: "recording.h5" in status["saved"])
    window.key("r", lambda status: status["bodyCount"] == 15 and status["step"] == 0)
    recording = Recording(tmp_path / "out" / "mixed" / "recording.h5")
    kinds = {change.kind for _, change in recording.changes}
    assert kinds == {"push", "add"} and recording.body_count(recording.lastStep) == 16
    assert verify(recording) == ""


@pytest.mark.slow
@pytest.mark.parametrize("size", [(800, 500), (1000, 700)])
def test_a_double_click_centres_a_body_and_the_readout_may_be_hidden(session, size):
    window = session(DATA / "mixed-scene.txt", size)
    if size[0] == 1000:
        window.key("n", lambda status: status["layout"][1] is None)
    first, middle = window.status(), np.array(size) / 2
    assert first["layout"][1] is None
    for _ in range(9):  # frames may take longer than a double-click
        window.move_to(*window.status()["bodies"][2])
        window.xdotool("click", "--repeat", 2, "--delay", 60, 1)
        for _ in range(6):
            window.await_frame()
        status = window.status()
        if np.abs(status["bodies"][2] - middle).max() < 2.0:
            break
        window.key("f")
        window.key("f")
    else:
        raise AssertionError(f"a double-click has no effect: {window.status()}")
    assert status["picked"] == 2
    # The readout opens for the body when the clicks are over; N hides it, and keeps the selection.
    window.await_status(lambda status: status["layout"][1] is not None)
    window.key("n", lambda status: status["layout"][1] is None and status["picked"] == 2)
    window.key("f", lambda status: np.abs(status["bodies"][2] - middle).max() > 20.0)
    window.key("f", lambda status: np.allclose(status["bodies"], first["bodies"], atol=2.0))


@pytest.mark.slow
def test_the_camera_orbits_about_the_scene_again_after_it_has_followed_a_body(session):
    window = session(DATA / "mixed-scene.txt")
    first = window.status()
    window.click_at(*first["bodies"][2])
    window.await_status(lambda status: status["picked"] == 2)
    window.click("camera follows", lambda status: status["follows"])
    window.key("space", lambda status: status["step"] > 20)
    window.key("b", lambda status: status["bodyCount"] > 15)
    window.key("space", lambda status: not status["isPlaying"])
    window.key("r", lambda status: status["step"] == 0)
    window.click("camera follows", lambda status: not status["follows"])
    window.key("bracketright", lambda status: status["scene"] == "tower-scene.txt")
    window.key("bracketleft", lambda status: status["scene"] == "mixed-scene.txt")
    for _ in range(2):
        before = window.status()["bodies"]
        window.move_to(300, 60)  # the sky
        window.xdotool("mousedown", 1)
        for x in range(320, 520, 20):
            window.move_to(x, 60)
        window.xdotool("mouseup", 1)
        after = window.await_status(
            lambda status, before=before: np.abs(np.subtract(status["bodies"], before)).max() > 50
        )["bodies"]
        assert all(0 < x < 1000 and 0 < y < 700 for x, y in after)
        window.key("f")
