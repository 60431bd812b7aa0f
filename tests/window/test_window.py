"""The real window on a virtual screen, driven by a mouse and keys."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from opengl import skip_or_fail
from oracles import ROOT
from program import DATA

# Seconds that one effect may take on a busy machine without a graphics card.
PATIENCE = 120.0


@pytest.fixture
def display():
    """The name of a virtual screen."""
    missing = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
    if missing:
        skip_or_fail(f"{' and '.join(missing)} missing: apt-get install xvfb xdotool")
    # The server chooses a free number itself, and writes it when it is ready.
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1920x1080x24"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(command, **pipes) as server:
        yield f":{server.stdout.readline().strip()}"
        server.terminate()


class Session:
    """The real window on a virtual screen, driven by a mouse and keys; see window_program.py."""

    def __init__(self, display, folder, path):
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
        self.xdotool("windowmove", self.window, 0, 0)
        self.xdotool("windowsize", self.window, 1000, 700)
        self.await_status(lambda status: status["windowSize"] == [1000, 700])
        # Keys go to the window that the mouse is over.
        self.xdotool("mousemove", "--window", self.window, 500, 350)

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

    def click(self, label, isReached, along=0.0):
        """Clicks a widget, `along` its width, over again until isReached(status)."""
        for _ in range(5):
            for _ in range(2):  # a list that opens is laid out in its first frames
                self.await_frame()
            places = self.await_status(lambda status: label in status["places"])["places"]
            x, y, width = places[label]
            self.click_at(x + along * width, y)
            with contextlib.suppress(AssertionError):
                return self.await_status(isReached, patience=PATIENCE / 10)
        raise AssertionError(f"clicking {label} has no effect: {self.status()}")

    def close(self):
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.communicate(timeout=60)
        finally:
            self.process.kill()
            self.process.wait()


@pytest.fixture
def window(display, tmp_path):
    session = Session(display, tmp_path, DATA / "tower-scene.txt")
    yield session
    session.close()


def test_a_session_in_the_window(window, tmp_path):
    """Mouse and keys arrive; what they do is tested off-screen, in test_panel.py."""
    window.click("Play", lambda status: status["isPlaying"])
    window.await_status(lambda status: status["step"] >= 5)
    status = window.click("friction", lambda status: status["friction"] > 0.1, along=0.2)
    assert status["isPlaying"] and status["frameRate"] == 60
    window.click("Pause", lambda status: not status["isPlaying"])
    window.xdotool("key", "r")
    window.await_status(lambda status: status["step"] == 0)
    # A body is picked where it is seen, and pushed; this is undone.
    window.click_at(*window.status()["bodies"][1])
    window.await_status(lambda status: status["picked"] == 1)
    window.click("Up", lambda status: status["velocity"][1] > 1.0)
    window.xdotool("key", "ctrl+z")
    window.await_status(lambda status: status["velocity"] == [0, 0, 0])
    window.click("Picture", lambda status: status["saved"])
    (saved,) = (tmp_path / "out" / "tower").iterdir()
    assert saved.read_bytes()[:4] == b"\x89PNG"
    # Nobody does anything: few pictures a second, until the mouse moves.
    window.await_status(lambda status: status["frameRate"] < 10)
    window.xdotool("mousemove_relative", 5, 5)
    window.await_status(lambda status: status["frameRate"] == 60)
    window.close()
    assert window.process.returncode == 0
