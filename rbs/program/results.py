"""What Python programs make of a run: pictures, videos, pages, exports, statistics.

`Results` is the base of `Simulation` and of opened recordings.
"""

from __future__ import annotations

import base64
import html
import io
import numbers
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rbs.pictures.drawing import backend, frames_of, picture_options, start_drawing
from rbs.program.headless import progress, state_summary
from rbs.recordings.outputs import Table
from rbs.recordings.page import PageWriter, Player
from rbs.recordings.replay import RecordedSettings
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.files import check_ending
from rbs.scenes.messages import check_kind, one_line
from rbs.scenes.scene import Writer, followed_by, steps_of_run
from rbs.scenes.scenefiles import scene_name
from rbs.scenes.simulation import check_attributes, no_attribute
from rbs.stepping.meshes import checked_count
from rbs.stepping.settings import Settings
from RBSFunctions import Mesh

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11

    from PIL import Image

# Width and height in pixels of the picture that a notebook shows of a simulation.
SMALL_SIZE = (480, 270)
# Types of the attributes of a run that may be assigned, and in words.
KINDS = {
    "settings": (Settings, "Settings"),
    "meshes": (list | tuple, "a list of Meshes"),
    "constraints": (list | tuple | np.ndarray, "a list of rows"),
    "groundMesh": (Mesh | None, "a Mesh or None"),
    "time": (numbers.Real, "a number"),
    "stepCount": (int, "a whole number"),
}


class Results:
    """The base of `Simulation` and of opened recordings: pictures, exports and statistics of them.

    `video`, `export`, `stats` and `show` make a number of steps, by default 500, or all that are
    left of a recording. They use the present state, and the state after every step. Whatever ends
    the steps, a video or an export is completed.
    """

    if not TYPE_CHECKING:  # for a type checker, it would allow every name

        def __setattr__(self, name, value):
            """Sets an attribute. Raises AttributeError if there is none of this name."""
            known = names_of(type(self))
            if name not in vars(self) and name[0] != "_" and name not in known:
                raise AttributeError(no_attribute(type(self).__name__, name, known))
            kind, what = KINDS.get(name, (object, ""))
            if name == "settings" and not self.isEditable:
                kind, what = RecordedSettings, "those of the recording"
            check_kind(name, value, kind, what)
            super().__setattr__(name, value)

    def step(self, observer: Callable | None = None) -> None:
        """Makes one step; of a recording, goes to the next one, if there is one.

        observer : function of each `Event` of the step; see `run_timestep`
        """
        check_attributes(self.meshes)
        super().step(observer)

    def picture(self, path: str | Path | None = None, **options: Any) -> Image.Image:
        """Draws the present state; returns a Pillow image.

        path : a .png file to write it to
        options : the fields of `PictureOptions`: size (width, height) in pixels, look ("plain" or
            "studio"), overlays, colouring, camera, which may be the path of a camera file

        Raises ValueError or TypeError if an argument is invalid, InputError if Polyscope cannot
        draw here. It draws in one thread of one process: workers that draw are spawned, not forked.
        """
        from PIL import Image

        if path is not None:
            check_ending(path, (".png",), "a picture")
        view = start_drawing(self, picture_options(options))
        from rbs.pictures.capture import save_picture, take_picture

        return Image.fromarray(take_picture(view) if path is None else save_picture(path, view))

    def video(
        self, path: str | Path, steps: int | None = None, every: int | None = None, **options: Any
    ) -> Self:
        """Makes steps and films every `every`-th one, in real time; returns itself.

        path : an .mp4 or .gif file; every : steps per frame, by default for about 25 frames per
            second; options : as for `picture`

        Raises OutputError if imageio-ffmpeg is missing.
        """
        OUTPUTS["video"].checked(path)
        every = None if every is None else checked_count(every, "every", 1)
        frames = frames_of(start_drawing(self, picture_options(options)), every)
        with self._written(OUTPUTS["video"].start(path, *frames)):
            return self.run(steps_of_run(self, steps))

    def export(self, path: str | Path, steps: int | None = None, colouring: str = "body") -> Self:
        """Makes steps and exports the run; returns itself.

        path : an .html page that plays the run in any browser, or a .glb file for 3-D programs
        colouring : as for `picture`; a .glb file has the colours of the last state

        Raises OutputError if k3d or pygltflib is missing.
        """
        picture_options({"colouring": colouring})  # checks it
        with self._written(OUTPUTS["export"].start(path, colouring)):
            return self.run(steps_of_run(self, steps))

    def stats(self, steps: int | None = None) -> dict[str, np.ndarray]:
        """Makes steps; returns the quantities of each: dict of arrays (steps + 1,).

        The names are "step" and those of `step_quantities`: energies and momenta, the largest
        violation, and from each report contacts, deepest penetration and times; NaN if unknown.
        """
        with followed_by(self, table := Table()):
            self.run(steps_of_run(self, steps))
        return table.columns()

    def show(self, steps: int | None = None, colouring: str = "body") -> Player:
        """Makes steps; returns a `Player`, in which a notebook plays the run.

        colouring : as for `picture`
        """
        picture_options({"colouring": colouring})
        with followed_by(self, writer := PageWriter(None, colouring)):
            self.run(steps_of_run(self, steps))
        return Player(writer.page(self))

    def run(self, count: int) -> Self:
        """Makes `count` steps, and shows the progress in a terminal; returns the simulation.

        Raises ValueError unless count is a whole number ≥ 0.
        """
        count = checked_count(count, "count, the number of steps,")
        check_attributes(self.meshes)
        for _ in progress(range(count)):
            super().step()
        return self

    @contextmanager
    def _written(self, writer: Writer) -> Iterator[Self]:
        """Returns a context whose steps a writer follows. Whatever ends it, the file is saved, but
        an error leaves an older file as it was, and the new one beside it.
        """
        begin = self.stepCount
        with closing(writer):
            try:
                with followed_by(self, writer):
                    yield self
            except BaseException:
                if self.stepCount != begin:
                    writer.save(self, isWhole=False)
                raise
            writer.save(self)

    def _repr_html_(self) -> str:
        """Returns a summary, and a picture if one can be drawn without a window."""
        rows = state_summary(self) | {"settings": repr(self.settings)}
        row = "<tr><th>{}</th><td>{}</td></tr>".format
        cells = "".join(row(name, html.escape(text)) for name, text in rows.items())
        title = f"<b>{html.escape(one_line(scene_name(self.scenePath)))}</b>"
        if backend().name is not None and not backend().opensWindow and self.meshes:
            self.picture(size=SMALL_SIZE).save(content := io.BytesIO(), "PNG")
            text = base64.b64encode(content.getvalue()).decode("ascii")
            title += f'<br><img alt="the scene" src="data:image/png;base64,{text}">'
        return f"<div>{title}<table>{cells}</table></div>"


@cache
def names_of(kind):
    """Returns the public names of the attributes of a class's instances."""
    names = {*dir(kind)}.union(*(vars(one).get("__annotations__", ()) for one in kind.__mro__))
    return sorted(name for name in names if name[0] != "_")
