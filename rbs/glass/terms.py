"""The value of each symbol in the formulas of an event, computed a second time from its states, by
`model`; `values` derives some of them from what a call did to its bodies.
"""

import math
from collections import namedtuple

import numpy as np

from rbs.glass import model
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
# Symbols of a state; and those of a constraint that holds.
STATE_SYMBOLS = "COM", "q", "v", "ω"
OF_VALID = "p1", "p2", "‖p1−p2‖", "refValue", "C", "tolerance", "n", "result"
# Impulses on body 2: symbol, direction, sign.
IMPULSES = (("j", "n", 1.0), ("λ", "n", -1.0), ("f", "t", 1.0))


def unit(symbol):
    """Returns the unit of a symbol, or ""."""
    plain = symbol.replace("′", "").translate({ord("1"): None, ord("2"): None})
    return UNITS.get(plain) or "1/kg" * (symbol == "K" or "⁻¹" in symbol)


def terms(event):
    """Returns the value of each symbol: a dict of floats, arrays, and words such as "sticks".

    The symbols are in the order in which they are computed.
    """
    found, kept = computed(event), None
    if "isValid" in event.given:
        found["result"] = _verdict(event.given, event.given["isValid"])
    if event.given.get("isValid"):
        kept = OF_VALID
    elif event.kind == Kind.FLIGHT and np.any(found["ω"] != event.after[0].angVelocity):
        kept = found.keys() - {"q′", "ω′"}  # gyroscopic
    return {symbol: value for symbol, value in found.items() if kept is None or symbol in kept}


def values(event):
    """Returns the symbols of `terms`, with states after the event, impulses, and the K that would
    explain them, by what the call did to its bodies, whoever wrote it.
    """
    found, numbers = terms(event), "12" if len(event.after) == 2 else [""]
    for k, after in zip(numbers, event.after, strict=True):
        for name, value in zip(STATE_SYMBOLS, after[:4], strict=True):
            if f"{name}{k}′" in found:
                found[f"{name}{k}′"] = value
    for symbol, along, sign in IMPULSES:
        if along in found and symbol in found and event.kind != Kind.POINT:
            told = float(sign * applied_impulse(event.before, event.after) @ found[along])
            if told and symbol != "f":
                found["K"] *= found[symbol] / told
            found[symbol] = told
    return found


# The formulas as they are; and a body, as `model.world_inverse_tensors` needs it.
UNEDITED = vars(model)
Body = namedtuple("Body", "mass centre tensor")


def computed(event, formulas=UNEDITED):
    """Returns the symbols of an event by the functions of `model`, by name, which may be edited."""
    given, found = event.given, {}
    if "depth" in given:
        found = {"d": given["depth"], "n": given["normal"], "p": given["points"][0]}
    if event.kind == Kind.FLIGHT:
        found = _flight(*event.before, event.given, formulas)
    elif compute := OF_TWO.get(event.kind):
        pair = _two(event, formulas)
        for k, x, v, w, m in zip("12", pair.x, pair.v, pair.w, pair.m, strict=True):
            found |= {f"v{k}": v, f"ω{k}": w} if event.kind != Kind.CORRECTION else {}
            found |= {f"COM{k}": x, f"m{k}⁻¹": m}
        isOnGround = event.bodies[1] == GROUND
        found |= compute(pair, given, formulas, -1.0 if isOnGround else 1.0)
    rows = {symbol: np.squeeze(value) for symbol, value in found.items()}
    return {symbol: row if row.ndim else row.item() for symbol, row in rows.items()}


def _flight(state, given, formulas):
    h, g = given["timeStep"], np.array(given["gravity"]) if state.invMass else np.zeros(3)
    x, q, v, w = (row[None] for row in state[:4])
    mass = 1.0 / (state.invMass or 1.0)
    newX, newQ, newV, newW = formulas["step"](x, q, v, w, np.array([[h]]), 1, mass, g[None])
    found = {"h": h, "g": g, "v": v, "v′": newV, "COM": x, "COM′": newX}
    return found | {"ω": w, "ω′": newW, "q": q, "q′": newQ}


def _two(event, formulas):
    """The Pair of an event's bodies."""
    columns = []
    for state in event.before:
        (x, q, v, w), T = (row[None] for row in state[:4]), np.zeros((1, 3, 3))
        if state.invMass and formulas is UNEDITED:
            T = world_inertia(state)[None]
        elif state.invMass:
            body = Body(1.0 / state.invMass, np.zeros(3), np.linalg.inv(state.invIT))
            T = formulas["world_inverse_tensors"](body, q, isReleased=bool(state.isTurnedBack))
        columns.append((x, q, v, w, float(state.invMass), T))
    return model.Pair(*zip(*columns, strict=True))


def _angular(name, n, r1, r2, a1, a2):
    found = {}
    for k, r, a in (("1", r1, a1), ("2", r2, a2)):
        torque, response = f"(r{k}×{name})", f"I{k}⁻¹(r{k}×{name})"
        found |= {f"{torque}ᵀ{response}": np.cross(r, n) @ a[0], response: a}
    return found


def _ends(names, *pairs):
    """Symbols of both bodies after the event."""
    pairs = zip(names.split(), pairs, strict=True)
    return {f"{name}{k}′": row for name, two in pairs for k, row in zip("12", two, strict=True)}


def _shares(pair):
    total = sum(pair.m)
    return {f"w{k}": m / total for k, m in zip("12", pair.m, strict=True)} if total else {}


def _collided(pair, given, formulas, sign, depth=0.0):
    """Calls `model.collide`; sign : -1 on the ground, where the coursework passes -d and -n"""
    contact = np.array([sign * depth]), sign * given["normal"][None], given["points"][1][None]
    after, found = formulas["collide"](pair, *contact, given["CRCoeff"])
    return zip(*after, strict=True), found


def _correction(pair, given, formulas, sign):
    (x, _v, _w), _terms = _collided(pair, given, formulas, sign, given["depth"])
    return _shares(pair) | _ends("COM", x)


def _impulse(pair, given, formulas, sign):
    (_x, v, w), (_p, r1, r2, u, speed, a1, a2, K, j) = _collided(pair, given, formulas, sign)
    found = {"r1": r1, "r2": r2, "u": u, "e": given["CRCoeff"], "u·n": sign * speed}
    found |= _angular("n", given["normal"], r1, r2, sign * a1, sign * a2)
    return found | {"K": K, "j": sign * j} | _ends("v ω", v, w)


def _friction(pair, given, formulas, _sign):
    n, p, impulse = given["normal"][None], given["points"][0][None], np.array([given["impulse"]])
    after, found = formulas["rub"](pair, n, p, given["mu"], impulse)
    r1, r2, u, t, speed, a1, a2, K, limit, f = found
    found = {"r1": r1, "r2": r2, "u": u, "μ": given["mu"], "t": t, "u·t": speed}
    found |= _angular("t", t[0], r1, r2, a1, a2)
    found |= {"K": K, "(u·t)/K": speed / K, "μj": limit, "f": f}
    found["result"] = "sticks" if speed / K <= limit else "slides"
    return found | _ends("v ω", *zip(*after, strict=True))


def _verdict(given, isValid):
    kind = "upper bound" if given["upper"] else "lower bound"
    return f"{kind} {'holds' if isValid else 'violated'}"


def _constraint(pair, given, formulas, _sign):
    p1, p2 = (np.reshape(one, (1, 3)) for one in given["points"])
    bound = np.array([given["refValue"]]), given["upper"], given["tolerance"], []
    (wasValid,), x, (n, length, C) = formulas["move"](pair, p1, p2, *bound)
    Jv, v, w, (r1, r2, a1, a2, K, impulse) = formulas["stop"](pair, p1, p2)
    if isSlow := formulas["is_slow"](Jv, given["tolerance"]):
        v, w = pair.v, pair.w
    found = {"p1": p1, "p2": p2, "‖p1−p2‖": length, "refValue": given["refValue"], "C": C}
    found["result"] = _verdict(given, wasValid)
    found |= {"tolerance": given["tolerance"], "n": n, "r1": r1, "r2": r2}
    found |= _shares(pair) | _ends("COM", x)
    for k, r, own, spin in zip("12", (r1, r2), pair.v, pair.w, strict=True):
        found |= {f"n·v{k}": n @ own[0], f"(r{k}×n)·ω{k}": np.cross(r, n) @ spin[0]}
    found |= {"Jv": Jv} | _angular("n", n[0], r1, r2, a1, -a2)
    return found | {"K": K, "λ": 0.0 if isSlow else impulse} | _ends("v ω", v, w)


def _point(pair, given, formulas, _sign):
    j, friction, mu = given["impulse"], given["friction"], float(given["mu"])
    n, slid = given["normal"], (given["points"][0][None], mu, np.array([j]))
    _after, (r1, r2, u, *_terms) = formulas["rub"](pair, n[None], *slid)
    size = math.hypot(*friction)
    found = {"r1": r1, "r2": r2, "u": u, "u·n": u[0] @ n, "j": j, "f": friction}
    found |= {"|f|": size, "μj": mu * j, "F": j / given["timeStep"]}
    kind = "slides" if size >= 0.999 * mu * j else "sticks"
    return found | {"result": kind if friction.any() else "no friction"}


OF_TWO = {Kind.CORRECTION: _correction, Kind.IMPULSE: _impulse, Kind.FRICTION: _friction}
OF_TWO |= {Kind.CONSTRAINT: _constraint, Kind.POINT: _point}
