"""Draws the README's gallery with the program itself: `python report/gallery.py [NAME ...]`.

Each picture is the last one of a run of the command line, at a moment of action, in the studio
look. It is drawn at twice the size and scaled down.
"""

import shlex
import sys
import tempfile
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rbs.scenes.files import atomic_write
from RigidBodySimulation import main

FOLDER = Path(__file__).resolve().parent / "gallery"
SIZE = (960, 540)
MOST_BYTES = 250_000
# JPEG qualities, tried in turn until the file is small enough.
QUALITIES = (95, 92, 88, 84, 80)
# Name → arguments, and number of the step.
PICTURES = {
    "wrecking_ball": ("wrecking_ball", 270),
    "net": ("net", 140),
    "pile": ("pile_200", 110),
    "stress": ("stress --friction 0.5 --show velocities contacts impulses --legend", 260),
    "heap": ("heap", 150),
    "card_house": ('card_house --show contacts impulses "friction impulses" --legend', 15),
    "arch": ("arch --show contacts impulses --legend", 20),
    "arch_blow": ("arch_blow", 190),
    "dominoes": ("dominoes", 330),
    "wall": ("wall", 320),
}


def draw(name):
    """Writes gallery/<name>.jpg; name : a name of PICTURES."""
    arguments, step = PICTURES[name]
    with tempfile.TemporaryDirectory() as folder:
        code = main(
            [
                *shlex.split(arguments),
                "--look",
                "studio",
                "--screenshots",
                folder,
                "--every",
                str(step),
                "--steps",
                str(step),
                "--size",
                "x".join(str(2 * pixels) for pixels in SIZE),
            ]
        )
        if code != 0:
            sys.exit(f"{name}: not drawn, exit code {code}")
        picture = Image.open(Path(folder) / f"frame_{step:06d}.png").resize(SIZE, Image.LANCZOS)
    for quality in QUALITIES:
        with atomic_write(FOLDER / f"{name}.jpg") as partial:
            picture.save(partial, "JPEG", quality=quality, subsampling=0, optimize=True)
        if (FOLDER / f"{name}.jpg").stat().st_size <= MOST_BYTES:
            return
    sys.exit(f"{name}.jpg is larger than {MOST_BYTES} bytes")


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        draw(name)
