"""Pages that play a run, opened in Chromium."""

import io
import json
import shutil
import time

import numpy as np
import pytest
from oracles import box_body
from PIL import Image
from program import call, skip_or_fail, wait_for

from rbs.appearance.colours import BodyColours, linear
from rbs.recordings.page import PageWriter
from rbs.scenes.scene import followed_by
from RigidBodySimulation import Simulation, main

pytest.importorskip("k3d")
ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync "
    "--window-size=480,320"
).split()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A fresh Chromium without a window, of Debian's packages chromium and chromium-driver."""
    programs = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if not all(programs):
        skip_or_fail("Debian's packages chromium and chromium-driver are missing")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = programs[0]
    for argument in (*ARGUMENTS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(programs[1]))
    driver.set_script_timeout(60)
    yield driver
    driver.quit()


def text_of(driver, name):
    return driver.execute_script("return document.getElementById(arguments[0]).innerText", name)


def seen_at(driver, seconds):
    """The picture after a click on the timeline, which pauses the run, (height, width, 3)."""
    driver.execute_script(
        "const line = document.getElementById('timeline'); line.value = arguments[0];"
        "line.dispatchEvent(new Event('input'));",
        seconds,
    )
    time.sleep(0.3)
    picture = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
    return np.asarray(picture).astype(int)


def test_a_page_opens_from_a_file_and_plays_without_a_request_or_an_error(tmp_path, browser):
    page = tmp_path / "run.html"
    words = "cradle --basic --friction 0.25 --steps 80 --export".split()
    assert main([*words, str(page)]) == 0
    browser.get(page.as_uri())
    wait_for(lambda: text_of(browser, "time") == "1.60 s of 1.60 s")
    assert "friction 0.25" in text_of(browser, "title")
    browser.execute_script("document.getElementById('play').click()")  # again
    wait_for(lambda: 0.0 < float(text_of(browser, "time").split()[0]) < 0.8)
    changes = np.abs(seen_at(browser, 0.6) - seen_at(browser, 0.0)).max(axis=2)
    assert (changes > 40).sum() > 300
    assert [line for line in browser.get_log("browser") if line["level"] == "SEVERE"] == []
    sent = [json.loads(line["message"])["message"] for line in browser.get_log("performance")]
    sent = [one["params"] for one in sent if one["method"] == "Network.requestWillBeSent"]
    asked = {one["request"]["url"] for one in sent if one["documentURL"] == page.as_uri()}
    assert {one for one in asked if not one.startswith(("data:", "blob:"))} == {page.as_uri()}


def test_a_page_has_speeds_and_bodies_as_long_as_they_are_there(tmp_path):
    """A falling box is removed after 1 s; one added later takes its place."""
    meshes = [box_body(2, 2, 2, (x, 12, 0)) for x in (0, 6)]
    meshes.append(box_body(2, 2, 2, (12, 1, 0), isFixed=True))
    simulation = Simulation.from_meshes(meshes, name="speeds")
    writer = PageWriter(tmp_path / "page.html", "speed")
    with followed_by(simulation, writer):
        simulation.run(50).constrain(1, 0, 2, 0, lower=0.0)
        simulation.run(2).remove(0)
        simulation.run(20).add(box_body(2, 2, 2, (0, 12, 0)))
        simulation.run(28)
    writer.save(simulation)
    *_, colours, span = writer.poses()
    assert span.tolist() == [[0, 0, 0, 37], [26, 50, 50, 50]]
    assert writer.links()[0].tolist() == [[1, 2]] and writer.links()[2].tolist() == [[26], [50]]
    assert np.abs(colours[25, 0] - colours[0, 0]).max() > 0.1  # as it falls
    np.testing.assert_allclose(colours[0, 0], colours[37, 3], atol=0.03)


# The matrix and the colour of each object that the player moves: bodies, shadows, links.
DRAWN = """return K3DInstance.then((page) => page.getWorld().K3DObjects.children
    .filter((one) => !one.matrixAutoUpdate)
    .map((one) => [...one.matrix.elements, one.material.color.getHex()]));"""


def test_bodies_and_links_are_drawn_as_the_run_has_them(tmp_path, browser):
    meshes = [box_body(2, 2, 2, (4 * x, 12, 0), isFixed=x == 2) for x in range(3)]
    links = [[0, 0, 1, 3, 9.0, True], [2, 1, 1, 0, 9.0, True]]
    simulation = Simulation.from_meshes(meshes, links)
    writer = PageWriter(tmp_path / "page.html", "speed")
    with followed_by(simulation, writer):
        simulation.run(30)
    writer.save(simulation)
    browser.get((tmp_path / "page.html").as_uri())
    wait_for(lambda: text_of(browser, "time").endswith("of 0.60 s"))
    places, _, colours, _ = writer.poses()
    seen_at(browser, writer.times()[5] + 1e-3)
    rows = np.array(browser.execute_script(DRAWN))
    np.testing.assert_allclose(rows[:3, 12:15], places[5], atol=5e-3)
    packed = np.rint(255 * colours[5]) @ (1 << 16, 1 << 8, 1)
    assert rows[:3, 16].tolist() == packed.tolist()
    ends = [places[5, b] + simulation.meshes[b].origVertices[v] for b, v in ((0, 0), (2, 1))]
    np.testing.assert_allclose(rows[-2:, 12:15], ends, atol=5e-3)


def test_the_colours_asked_for_are_in_the_file(tmp_path, capsys):
    words = ["tower", "--steps", 2, "--colours", "density", "--export"]
    assert call(capsys, *words, tmp_path / "d.glb")[0] == 0
    pygltflib = pytest.importorskip("pygltflib")
    found = pygltflib.GLTF2().load(str(tmp_path / "d.glb"))
    simulation = Simulation("tower")
    expected = linear(BodyColours(simulation.meshes).of(simulation, "density"))
    for node, mesh, colour in zip(found.nodes, simulation.meshes, expected, strict=False):
        assert node.name == mesh.name
        material = found.materials[found.meshes[node.mesh].primitives[0].material]
        np.testing.assert_allclose(material.pbrMetallicRoughness.baseColorFactor[:3], colour)
    with pytest.raises(ValueError, match="colouring must be one of body, "):
        simulation.export(tmp_path / "x.html", colouring="heat")
