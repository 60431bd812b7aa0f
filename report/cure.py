"""Section 5: which part of the soft step cures what, blows on sleepers, and compiled engines."""

import numpy as np
import runs
import style
from basic import STACK_STEPS, flat_box, swaying
from engines import KEYS, SIZES, measured
from friction import creep
from runs import AWAKE, BOX, SUBSTEPS, H, box, experiment, run

TALL, REST_STEPS = 20, 400  # boxes, and steps until they rest
PARTS = {  # name → time step, options of run_timestep
    "basic": (H, {}),
    "small": (H / SUBSTEPS, {}),
    "shared": (H, AWAKE | {"substeps": 1}),
    "both": (H, AWAKE),
}


@experiment()
def ablation():
    """Small steps and shared contacts apart: sway in °/s, creep in cm, and by how much
    the top of a tall stack is too low in m after STACK_STEPS, all awake; and the ratio of what
    it sinks with one substep and with several.
    """
    numbers = {"tall": TALL}
    for name, (h, options) in PARTS.items():
        steps, flat, tall = round(STACK_STEPS * H / h), flat_box(), runs.stacked(TALL)
        runs.finish(tall, steps, h, 0.0, mu=0.5, **(options or runs.BATCHED))
        numbers[name] = {
            "sway": swaying(run([flat], 1000, h, **options), flat)[0],
            "creep": 100 * creep(h, **options)[-1],
            "low": BOX[1] * (TALL - 0.5) - float(tall[-1].position[0, 1]),
        }
    # at rest: after STACK_STEPS, that with one substep still rises
    ends = []
    for name in ("shared", "both"):
        runs.finish(tall := runs.stacked(TALL), REST_STEPS, H, 0.0, mu=0.5, **PARTS[name][1])
        ends.append(BOX[1] * (TALL - 0.5) - float(tall[-1].position[0, 1]))
    numbers["ratio"] = ends[0] / ends[1]
    return numbers | {"sixth": numbers["basic"]["creep"] / SUBSTEPS}


CALM_STEPS, FREE, BLOW = 60, 2.0, 10.0  # steps until bodies sleep; m, m/s of the striker

STARTS = np.array([-BOX[0] - FREE, 0.0, BOX[0]])


def struck(**options):
    """Ways in m (n, 3) of a box that strikes two at rest, which touch, without friction (e = 0)."""
    meshes, ways = [box((x, BOX[1] / 2, 0)) for x in STARTS], []
    for step, report in enumerate(run(meshes, CALM_STEPS + 100, e=0.0, **options)):
        if step == CALM_STEPS:
            slept = report.isAsleep[1:].all()
            runs.throw(meshes[0], (BLOW, 0, 0))
        if step >= CALM_STEPS:
            ways.append([mesh.position[0, 0] for mesh in meshes] - STARTS)
    return np.array(ways), slept


@experiment((3.7, 4.7))
def blow(axis):
    """Ways of bodies that a blow finds asleep, beside those that it finds awake."""
    (asleep, slept), (awake, _) = struck(**runs.SOFT), struck(**AWAKE)
    time = H * np.arange(len(awake))
    looks = zip(("striker", "first struck", "second struck"), style.LOOKS, strict=True)
    for k, (name, (colour, mark)) in enumerate(looks):
        axis.plot(time, awake[:, k], color=colour)
        axis.plot(time, asleep[:, k], mark, color=colour, markevery=(3 * k, 12), label=name)
    axis.set(xlabel="time / s", ylabel="distance / m", xlim=(0, time[-1]), ylim=(-0.3, 12))
    axis.legend(loc="upper left")
    numbers = {"slept": float(slept), "speed": BLOW}
    for name, ways in (("asleep", asleep), ("awake", awake)):
        numbers[name] = float((ways[-1] - ways[-2]).mean() / H)
    return numbers | {"differs": 100 * float(np.abs(asleep - awake).max() / awake[-1].max())}


@experiment((4.9, 4.7), isTimed=True)
def engines(axis):
    """Milliseconds of a step of engines, from the states of a heap that collapses or rests."""
    numbers = measured(SIZES)
    for regime, line, fill in (("collapse", "-", "full"), ("rest", "--", "none")):
        for key, (colour, mark) in zip(("bullet", "cg", "soft"), style.LOOKS, strict=True):
            how = {"color": colour, "fillstyle": fill, "label": KEYS[key] if fill == "full" else ""}
            times = [numbers[regime][f"n{count}"][key] for count in SIZES]
            axis.loglog(SIZES, times, mark + line, **how)
    style.ticks(axis, SIZES, (1, 10, 100))
    axis.set(xlabel="bodies", ylabel="ms per step", xlim=(160, 6500), ylim=(0.7, 2000))
    axis.legend(loc="upper left")
    return numbers
