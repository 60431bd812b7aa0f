"""The formulas of an event, and the value of each symbol in them, computed a second time from the
event's states; `values` derives some of them from what a call did to its bodies.
"""

import math

import numpy as np

from Quaternion import exponential, multiply
from rbs.glass.events import Kind, applied_impulse, world_inertia
from rbs.stepping.reports import GROUND

# Units by symbol, without digits of bodies and primes. K and its terms have 1/kg.
SYMBOLS = {
    "m": "d p r COM C refValue tolerance ‖p−p‖",
    "m/s": "u v u·n u·t Jv n·v (r×n)·ω",
    "rad/s": "ω",
    "N s": "j λ f |f| μj (u·t)/K",
    "1/(kg m)": "I⁻¹(r×n) I⁻¹(r×t)",
    **{"s": "h", "m/s²": "g", "N": "F"},
}
UNITS = {symbol: unit for unit, symbols in SYMBOLS.items() for symbol in symbols.split()}
# Impulses on body 2: symbol, direction, sign.
IMPULSES = (("j", "n", 1.0), ("λ", "n", -1.0), ("f", "t", 1.0))
# What several formulas have in common; r1 and r2 are those after the position correction.
K = "K = m1⁻¹ + m2⁻¹ + (r1×n)ᵀI1⁻¹(r1×n) + (r2×n)ᵀI2⁻¹(r2×n)"
U = "u = v1 + ω1 × r1 − ( v2 + ω2 × r2 )"
PUSHED = (
    "v1′ = v1 − j m1⁻¹ n; ω1′ = ω1 − j I1⁻¹(r1×n); v2′ = v2 + j m2⁻¹ n; ω2′ = ω2 + j I2⁻¹(r2×n)"
)
ARMS = "r1 = p − COM1; r2 = p − COM2"
# The formulas of each kind, as the coursework writes them, with ′ for values after the event. Words
# between blanks have a value if they are symbols of `terms`.
FORMULAS = {
    Kind.FLIGHT: "v′ = v + g h; COM′ = COM + v′ h; q′ = exp( ½ h ω ) ◦ q , w first",
    Kind.CONTACT: "depth d; normal n , from 1 to 2; deepest point p",
    Kind.CORRECTION: "w1 = m1⁻¹ / ( m1⁻¹ + m2⁻¹ ); w2 = 1 − w1; COM1′ = COM1 − w1 d n; "
    "COM2′ = COM2 + w2 d n",
    Kind.IMPULSE: f"j = (1 + e ) u·n / K; {K}; {U}; {PUSHED}; {ARMS}",
    Kind.FRICTION: "f = min( (u·t)/K , μj ) : the body result; "
    f"{K.replace('×n', '×t')}; u·t along t; {U}; {ARMS}",
    Kind.CONSTRAINT: "C = ‖p1−p2‖ − refValue : result; COM1′ = COM1 − w1 C n; "
    "COM2′ = COM2 + w2 C n; λ = − Jv / K; Jv = n·v1 + (r1×n)·ω1 − n·v2 − (r2×n)·ω2; "
    f"{K}; {PUSHED.translate(str.maketrans('j−+', 'λ+−'))}; "
    "n = ( p1 − p2 ) / ‖p1−p2‖; r1 = p1 − COM1; r2 = p2 − COM2",
    Kind.POINT: "depth d at the start of the step; normal n; u·n after the step, > 0 if "
    "approaching; j along n; |f| ≤ μj : result",
}


# What an event did, and why, by its kind or result. Of a vector, the length is shown.
TOLD = {
    Kind.FLIGHT: "Gravity changes the velocity, and the new velocity moves the body.",
    Kind.BOXES: "The bounding boxes overlap. If the bodies do, too, a contact follows.",
    Kind.CONTACT: "The bodies overlap by {d} along n, which points from body 1 to body 2.",
    "the ground": "The body is {d} deep in the ground. n points from body 1 to body 2; the "
    "coursework passes −d and −n, to the same effect.",
    Kind.CORRECTION: "Moves the bodies apart by the depth, {d}, each by its share w.",
    Kind.IMPULSE: "The bodies {before} along n. The impulse changes {changes}: now they {after}.",
    "sticks": "The contact slides at {u·t} along t. Friction stops this, and changes {changes}.",
    "slides": "The contact slides at {u·t} along t. Friction reaches its limit μj, and changes "
    "{changes}.",
    "holds": "The distance of the points keeps to its bound: nothing is corrected.",
    "violated": "The distance of the points is wrong by {C}: moves them until C = 0, and changes "
    "{changes}.",
    Kind.POINT: "Pushes with {F} on average, in the last step in which it was awake. All points "
    "and constraints are solved together.",
}


def unit(symbol):
    """Returns the unit of a symbol, or ""."""
    plain = symbol.replace("′", "").translate({ord("1"): None, ord("2"): None})
    return UNITS.get(plain) or "1/kg" * (symbol == "K" or "⁻¹" in symbol)


def formulas(event):
    """Returns the formulas of an event, without those of a body that cannot move, and without the
    corrections of a valid constraint.
    """
    lines = FORMULAS.get(event.kind, "").split("; ")
    if event.given.get("isValid"):
        return lines[:1]
    still = [f"{k}′ = " for k, one in enumerate(event.before, 1) if one.invMass == 0.0]
    return [one for one in lines if one and not any(text in one for text in still)]


def terms(event):
    """Returns the value of each symbol: a dict of floats, arrays, and words such as "sticks".

    The symbols of `formulas`, and others, in the order in which they are computed.
    """
    return _TERMS[event.kind](event, event.given)


def values(event):
    """Returns the symbols of `terms`, with states after the event, impulses, and the K that would
    explain them, by what the call did to its bodies, whoever wrote it.
    """
    found, numbers = terms(event), "12" if len(event.after) == 2 else [""]
    for k, after in zip(numbers, event.after, strict=True):
        for name, value in zip(("COM", "q", "v", "ω"), after[:4], strict=True):
            if f"{name}{k}′" in found:
                found[f"{name}{k}′"] = value
    for symbol, along, sign in IMPULSES:
        if along in found and symbol in found and event.kind != Kind.POINT:
            told = float(sign * applied_impulse(event.before, event.after) @ found[along])
            if told and symbol != "f":
                found["K"] *= found[symbol] / told
            found[symbol] = told
    return found


def sentence(event):
    """Returns a sentence on what an event did, and why."""
    found, key = values(event), event.kind
    lengths = {s: f"{np.linalg.norm(v):.3g} {unit(s)}" for s, v in found.items() if s != "result"}
    if key in (Kind.FRICTION, Kind.CONSTRAINT):
        key = found["result"].split()[-1]
    elif key == Kind.CONTACT and event.bodies[1] == GROUND:
        key = "the ground"
    elif key == Kind.IMPULSE:
        ends = found["u·n"], float(terms(event._replace(before=event.after))["u·n"])
        for name, u in zip(("before", "after"), ends, strict=True):
            lengths[name] = f"{'part' if u < 0.0 else 'approach'} at {abs(u):.3g} m/s"
    changes = [
        f"{name} by {math.hypot(*(found[f'{name}′'] - found[name])):.3g} {unit(name)}"
        for k, state in enumerate(event.before, 1)
        for name in (f"v{k}", f"ω{k}")
        if state.invMass and f"{name}′" in found
    ]
    text = TOLD[key].format_map(lengths | {"changes": ", ".join(changes)})
    isPulled = key == Kind.IMPULSE and found["u·n"] < 0.0 < -found["j"]
    return text + " The coursework applies it whatever the sign of u·n." * isPulled


def _flight(event, given):
    (state,), h = event.before, given["timeStep"]
    g = np.array(given["gravity"]) if state.invMass else np.zeros(3)
    found = {"h": h, "g": g, "v": state.linVelocity, "v′": state.linVelocity + h * g}
    found |= {"COM": state.position, "COM′": state.position + h * found["v′"]}
    found |= {"ω": state.angVelocity, "q": state.orientation}
    if np.array_equal(state.angVelocity, event.after[0].angVelocity):  # not gyroscopic
        turn = exponential((0.0, *(0.5 * h * state.angVelocity)))
        found["q′"] = np.array(multiply(turn, state.orientation))
    return found


def _contact(event, given):
    return {"d": given["depth"], "n": given["normal"], "p": given["points"][0]}


def _corrected(event, move):
    """The shares of both bodies in a position correction, (3,) along n, and their COMs after it."""
    found, total = {}, sum(one.invMass for one in event.before)
    for k, sign, one in zip("12", (-1.0, 1.0), event.before, strict=True):
        share = one.invMass / total
        found |= {f"m{k}⁻¹": one.invMass, f"w{k}": share, f"COM{k}": one.position}
        found[f"COM{k}′"] = one.position + sign * share * move
    return found


def _correction(event, given):
    return _contact(event, given) | _corrected(event, given["depth"] * given["normal"])


def _arms(event):
    """Returns v, ω and the arm r of both bodies, and their relative velocity u, by symbol."""
    found = {}
    for k, state, p in zip("12", event.before, event.given["points"], strict=True):
        found |= {f"v{k}": state.linVelocity, f"ω{k}": state.angVelocity}
        found |= {f"COM{k}": state.position, f"r{k}": p - state.position}
    v1, v2 = (found[f"v{k}"] + np.cross(found[f"ω{k}"], found[f"r{k}"]) for k in "12")
    return found | {"u": v1 - v2}


def _masses(event, found, name="n"):
    """The terms of K along n, or t, and K."""
    K = 0.0
    for k, state in zip("12", event.before, strict=True):
        torque, response = f"(r{k}×{name})", f"I{k}⁻¹(r{k}×{name})"
        across = np.cross(found[f"r{k}"], found[name])
        turn = world_inertia(state) @ across
        share = float(across @ turn)
        found |= {f"m{k}⁻¹": state.invMass, f"{torque}ᵀ{response}": share, response: turn}
        K += state.invMass + share
    return found | {"K": K}


def _moved(event, found, j, name="n"):
    """The velocities after an impulse -j n on body 1 and +j n on body 2, or along t."""
    for k, push, state in zip("12", (-j, j), event.before, strict=True):
        found[f"v{k}′"] = state.linVelocity + push * state.invMass * found[name]
        found[f"ω{k}′"] = state.angVelocity + push * found[f"I{k}⁻¹(r{k}×{name})"]
    return found


def _impulse(event, given):
    found = _contact(event, given) | _arms(event) | {"e": float(given["CRCoeff"])}
    found["u·n"] = float(found["u"] @ found["n"])
    found = _masses(event, found)
    found["j"] = (1.0 + found["e"]) * found["u·n"] / found["K"]
    return _moved(event, found, found["j"])


def _friction(event, given):
    found = _contact(event, given) | _arms(event) | {"μ": float(given["mu"])}
    across = found["u"] - (found["u"] @ found["n"]) * found["n"]
    speed = math.hypot(*across)
    found |= {"t": across / (speed or 1.0), "u·t": speed}
    found = _masses(event, found, "t")
    found |= {"(u·t)/K": speed / found["K"], "μj": max(found["μ"] * given["impulse"], 0.0)}
    found["f"] = min(found["(u·t)/K"], found["μj"])
    found["result"] = "sticks" if found["(u·t)/K"] <= found["μj"] else "slides"
    return _moved(event, found, found["f"], "t")


def _constraint(event, given):
    p1, p2 = given["points"]
    length = math.hypot(*(p1 - p2))
    n = (p1 - p2) / length if length else np.array([0.0, 1.0, 0.0])
    found = {"p1": p1, "p2": p2, "‖p1−p2‖": length, "refValue": float(given["refValue"])}
    found |= {"C": length - found["refValue"], "tolerance": float(given["tolerance"]), "n": n}
    bound = "upper bound" if given["upper"] else "lower bound"
    found["result"] = f"{bound} {'holds' if given['isValid'] else 'violated'}"
    if given["isValid"]:
        return found
    found |= _corrected(event, found["C"] * n) | _arms(event)
    for k in "12":
        found[f"n·v{k}"] = float(n @ found[f"v{k}"])
        found[f"(r{k}×n)·ω{k}"] = float(np.cross(found[f"r{k}"], n) @ found[f"ω{k}"])
    found["Jv"] = float(found["u"] @ n)
    found = _masses(event, found)
    found["λ"] = -found["Jv"] / found["K"] if abs(found["Jv"]) > found["tolerance"] else 0.0
    return _moved(event, found, -found["λ"])


def _point(event, given):
    found, friction = _contact(event, given) | _arms(event), given["friction"]
    found |= {"u·n": float(found["u"] @ found["n"]), "j": given["impulse"], "f": friction}
    found |= {"|f|": math.hypot(*friction), "μj": float(given["mu"]) * given["impulse"]}
    found["F"] = given["impulse"] / given["timeStep"]
    isFull = found["|f|"] >= 0.999 * found["μj"]
    found["result"] = "no friction" if not friction.any() else "slides" if isFull else "sticks"
    return found


_TERMS = {
    Kind.FLIGHT: _flight,
    Kind.BOXES: lambda event, given: {},
    Kind.CONTACT: _contact,
    Kind.CORRECTION: _correction,
    Kind.IMPULSE: _impulse,
    Kind.FRICTION: _friction,
    Kind.CONSTRAINT: _constraint,
    Kind.POINT: _point,
}
