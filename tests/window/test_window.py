"""The real window on a virtual screen, driven by a mouse and keys."""

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
PATIENCE = 300.0


@pytest.fixture
def display():
    """The name of a virtual screen."""
    missing = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
    if missing:
        skip_or_fail(f"{' and '.join(missing)} missing: apt-get install xvfb xdotool")
    # The server chooses a free number itself, and writes it when it is ready.
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x720x24"]
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
            self.await_status(lambda status: status["frameCount"] > 2)
        except AssertionError as error:
            skip_or_fail(f"no window opens on the virtual screen: {error}")

    def xdotool(self, *arguments):
        command, options = ["xdotool", *map(str, arguments)], {"text": True, "timeout": 60}
        done = subprocess.run(command, env=self.environment, capture_output=True, **options)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def await_status(self, isReached):
        """The status as soon as isReached(status); the window must live, and time not be up."""
        end, status = time.monotonic() + PATIENCE, None
        while time.monotonic() < end:
            assert self.process.poll() is None, self.process.stderr.read()
            if self.statusPath.exists():
                status = json.loads(self.statusPath.read_text())
                if isReached(status):
                    return status
            time.sleep(0.05)
        raise AssertionError(f"not within {PATIENCE} s: {status}")

    def await_frames(self, count):
        """Waits until so many further frames have been drawn."""
        last = self.await_status(lambda status: True)["frameCount"]
        self.await_status(lambda status: status["frameCount"] >= last + count)

    def key(self, keys, isReached):
        """Presses keys, and waits for their effect."""
        self.xdotool("key", keys)
        return self.await_status(isReached)

    def click_at(self, x, y):
        """A click that every frame sees: the button is down for at least two."""
        window = self.xdotool("search", "--name", "Rigid bodies").split()[-1]
        self.xdotool("mousemove", "--window", window, round(x), round(y))
        for action in ("mousedown", "mouseup"):
            self.await_frames(2)
            self.xdotool(action, 1)

    def close(self):
        """Ends the program as Ctrl-C does; returns what it wrote to the terminal."""
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.communicate(timeout=300)[1]
        finally:
            self.process.kill()
            self.process.wait()


def test_a_session_in_the_window(display, tmp_path):
    """A dozen keys and the mouse arrive; what they do is tested off-screen, in test_panel.py."""
    window = Session(display, tmp_path, DATA / "tower-scene.txt")
    window.xdotool("mousemove", 640, 200)  # keys go to the window that the mouse is over
    status = window.key("space", lambda status: status["step"] >= 5)
    assert status["isPlaying"] and status["frameRate"] == 60
    assert status["windowSize"] == [1280, 720]
    status = window.key("space", lambda status: not status["isPlaying"])
    step, count = status["step"], len(status["bodies"])
    window.key("b", lambda status: len(status["bodies"]) == count + 1)
    window.key("ctrl+z", lambda status: len(status["bodies"]) == count)
    window.key("ctrl+shift+z", lambda status: len(status["bodies"]) == count + 1)
    window.key("ctrl+z", lambda status: len(status["bodies"]) == count)
    window.key("Left", lambda status: status["step"] == step - 1)
    window.key("Right", lambda status: status["step"] == step)
    while window.key("e", lambda status: True)["event"] is None:  # until bodies touch
        window.await_frames(6)
    window.key("Escape", lambda status: status["event"] is None)
    window.key("1", lambda status: status["ahead"][2] < -0.99)
    window.key("3", lambda status: status["ahead"][0] < -0.99)
    window.key("7", lambda status: status["ahead"][1] < -0.99)
    window.key("f", lambda status: status["ahead"][1] > -0.9)
    window.key("r", lambda status: status["step"] == 0)
    window.await_frames(2)
    window.click_at(*window.await_status(lambda status: True)["bodies"][1])
    window.await_status(lambda status: status["picked"] == 1)
    # Nobody does anything: few pictures a second, until the mouse moves.
    window.await_status(lambda status: status["frameRate"] < 10)
    window.xdotool("mousemove_relative", 5, 5)
    window.await_status(lambda status: status["frameRate"] == 60)
    window.close()
    assert window.process.returncode == 0
