"""The real window on a virtual screen, driven by a mouse and keys."""

import json
import os
import shutil
import signal
import subprocess
import sys

import pytest
from oracles import ROOT
from program import DATA, skip_or_fail, wait_for


@pytest.fixture
def session(tmp_path):
    missing = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
    if missing:
        skip_or_fail(f"{' and '.join(missing)} missing: apt-get install xvfb xdotool")
    # The server chooses a free number itself, and writes it when it is ready.
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x720x24"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    with subprocess.Popen(command, **pipes) as server:
        display = f":{server.stdout.readline().strip()}"
        window = Session(display, tmp_path, DATA / "tower-scene.txt")
        yield window
        window.process.kill()
        window.process.communicate()
        server.terminate()


class Session:
    """The real window, driven by a mouse and keys; see window_program.py."""

    def __init__(self, display, folder, path):
        self.statusPath = folder / "status.json"
        self.environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, ROOT / "tests/window/window_program.py", path, self.statusPath]
        options = {"cwd": folder, "env": self.environment, "text": True}
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, **options)
        try:
            self.wait(lambda status: status["frameCount"] > 2)
        except AssertionError as error:
            skip_or_fail(f"no window opens on the virtual screen: {error}")

    def do(self, *arguments):
        command = ["xdotool", *map(str, arguments)]
        subprocess.run(command, env=self.environment, check=True)

    def wait(self, isReached=lambda status: True):
        """The status as soon as isReached(status), while the window lives."""

        def reached():
            status = self.statusPath.exists() and json.loads(self.statusPath.read_text())
            return status if status and isReached(status) else None

        return wait_for(reached, lambda: self.process.poll() is None)

    def wait_frames(self, count):
        last = self.wait()["frameCount"]
        return self.wait(lambda status: status["frameCount"] >= last + count)

    def key(self, keys, isReached):
        self.do("key", keys)
        return self.wait(isReached)


@pytest.mark.slow
def test_keys_and_the_mouse_arrive(session):
    """What they do is tested off-screen, in test_panel.py."""
    session.do("mousemove", 640, 200)  # keys go to the window that the mouse is over
    status = session.key("space", lambda status: status["step"] >= 5)
    assert status["isPlaying"] and status["frameRate"] == 60
    assert status["windowSize"] == [1280, 720]
    status = session.key("space", lambda status: not status["isPlaying"])
    step, count = status["step"], len(status["bodies"])
    for keys, more in (("b", 1), ("ctrl+z", 0), ("ctrl+shift+z", 1), ("ctrl+z", 0)):
        session.key(keys, lambda status, more=more: len(status["bodies"]) == count + more)
    for keys, back in (("Left", 1), ("Right", 0)):
        session.key(keys, lambda status, back=back: status["step"] == step - back)
    while session.key("e", lambda status: True)["event"] is None:  # until bodies touch
        session.wait_frames(6)
    session.key("Escape", lambda status: status["event"] is None)
    for keys, axis in (("1", 2), ("3", 0), ("7", 1)):
        session.key(keys, lambda status, axis=axis: status["ahead"][axis] < -0.99)
    session.key("f", lambda status: status["ahead"][1] > -0.9)
    session.key("r", lambda status: status["step"] == 0)
    session.do("mousemove", *map(round, session.wait_frames(2)["bodies"][1]))
    for action in ("mousedown", "mouseup"):  # which every frame sees
        session.wait_frames(2)
        session.do(action, 1)
    session.wait(lambda status: status["picked"] == 1)
    # Nobody does anything: few pictures a second, until the mouse moves.
    session.wait(lambda status: status["frameRate"] < 10)
    session.do("mousemove_relative", 5, 5)
    session.wait(lambda status: status["frameRate"] == 60)
    session.process.send_signal(signal.SIGINT)
    assert session.process.wait(timeout=600) == 0
