"""Draws the README's gallery with the program itself: `python report/gallery.py [NAME ...]`.

Each picture is the last one of a run of the command line, in the studio look. It is drawn at twice
the size and scaled down. Videos have one camera, which sees their first and their last moment.
"""

import shlex
import sys
import tempfile
from pathlib import Path

from PIL import Image
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rbs.appearance.framing import frame_still
from rbs.appearance.pictureoptions import PictureOptions
from rbs.opening.suggestions import apply_settings
from rbs.pictures.backends import find_backend
from rbs.recordings.encoder import Encoder
from rbs.scenes.files import atomic_write
from RigidBodySimulation import Simulation, main

FOLDER = Path(__file__).resolve().parent / "gallery"
SIZE = (960, 540)
MOST_BYTES = 250_000
# JPEG qualities, tried in turn until the file is small enough.
QUALITIES = (95, 92, 88, 84, 80)
# Name → arguments, and number of the step.
PICTURES = {
    "wrecking_ball": ("wrecking_ball", 300),
    "net": ("net", 140),
    "pile": ("pile_200", 110),
    "stress": ("stress --friction 0.5 --show velocities contacts impulses --legend", 160),
    "heap": ("heap", 600),
    "card_house": ('card_house --show contacts impulses "friction impulses" --legend', 15),
    "arch": ("arch --show contacts impulses --legend", 20),
    "arch_blow": ("arch_blow", 190),
    "dominoes": ("dominoes", 560),
    "wall": ("wall", 320),
}
# Name of a video → scene, number of the first and of the last step, and steps per frame.
VIDEOS = {"wall.mp4": ("wall", 190, 490, 2), "dominoes.mp4": ("dominoes", 260, 780, 4)}
VIDEO_SIZE, RATE = (1280, 720), 25
CODEC = "-f mp4 -vcodec libx264 -pix_fmt yuv420p -crf 20 -preset slow -movflags +faststart"


def draw(name):
    """Writes gallery/<name>.jpg; name : a name of PICTURES."""
    arguments, step = PICTURES[name]
    words = f"{arguments} --look studio --steps {step} --every {step} --size 1920x1080"
    with tempfile.TemporaryDirectory() as folder:
        code = main([*shlex.split(words), "--screenshots", folder])
        if code != 0:
            sys.exit(f"{name}: not drawn, exit code {code}")
        picture = Image.open(Path(folder) / f"frame_{step:06d}.png").resize(SIZE, Image.LANCZOS)
    for quality in QUALITIES:
        with atomic_write(FOLDER / f"{name}.jpg") as partial:
            picture.save(partial, "JPEG", quality=quality, subsampling=0, optimize=True)
        if (FOLDER / f"{name}.jpg").stat().st_size <= MOST_BYTES:
            return
    sys.exit(f"{name}.jpg is larger than {MOST_BYTES} bytes")


def film(name):
    """Writes gallery/<name>; name : a name of VIDEOS."""
    import polyscope as ps

    from rbs.pictures.capture import start_view, take_picture

    scene, first, last, every = VIDEOS[name]
    simulation, end = Simulation(scene), Simulation(scene)
    for one, step in ((simulation, first), (end, last)):
        apply_settings(one, {})
        one.run(step)
    options = PictureOptions(VIDEO_SIZE, look="studio")
    view = start_view(simulation, find_backend(window=False), options)
    ps.look_at(*frame_still(simulation.meshes + end.meshes, VIDEO_SIZE))
    view.spread_ground()
    steps = range(first, last + 1, every)
    view.studio.tell_cost(view, len(steps))
    with atomic_write(FOLDER / name) as partial:
        encoder = Encoder(partial, VIDEO_SIZE, RATE, CODEC.split())
        for _ in tqdm(steps, name, disable=None):
            view.refresh()
            encoder.write(take_picture(view, isStill=False))
            simulation.run(every)
        encoder.finish()


if __name__ == "__main__":
    for name in sys.argv[1:] or (*PICTURES, *VIDEOS):
        film(name) if name in VIDEOS else draw(name)
