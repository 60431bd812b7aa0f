"""The window's help: all keys, and what the mouse does.

Polyscope is imported inside the functions that use it.
"""

KEYS = {
    "Space": "play, pause",
    "S, Right": "one step on",
    "Left": "one step back, in a recording",
    "R": "reset: bodies and settings as at the start",
    "Backspace": "restart: bodies as the scene has them, settings as they are",
    "B": "shoot a ball at what is under the mouse",
    "F": "frame all bodies",
    "N": "show or hide the numbers at the right",
    "H, F1, ?": "show or hide this help",
    "Escape": "close a list, or this help",
}
MOUSE = {
    "click": "pick a body: its numbers, pushing, fixing",
    "Ctrl + drag": "drag a body; let go to throw it",
    "drag": "turn the view",
    "Shift + drag, right drag": "move the view",
    "wheel": "nearer, further away",
    "drop a file": "open a scene, a recording or a camera",
}
# Where the explanations begin, in pixels.
INDENT = 180


def draw_help(centre, most):
    """Draws the panel; returns whether it stays open. centre, most : pixels, its place and size."""
    import polyscope.imgui as psim

    psim.SetNextWindowPos(centre, psim.ImGuiCond_Always, (0.5, 0.5))
    psim.SetNextWindowSizeConstraints((0, 0), most)
    psim.SetNextWindowBgAlpha(1.0)
    flags = psim.ImGuiWindowFlags_AlwaysAutoResize | psim.ImGuiWindowFlags_NoCollapse
    psim.Begin("Help", flags=flags | psim.ImGuiWindowFlags_NoMove)
    for title, rows in (("Keys", KEYS), ("Mouse", MOUSE)):
        psim.SeparatorText(title)
        for name, text in rows.items():
            psim.Text(name)
            psim.SameLine(INDENT)
            psim.Text(text)
    psim.Separator()
    stays = not psim.Button("Close")
    psim.End()
    return stays
