"""Puts one-line faults into copies of the code and looks whether a test notices each.

    python tests/campaigns/mutations.py            all faults of FAULTS, one line of output each
    python tests/campaigns/mutations.py 3 8        these, counted from 1

A fault replaces a text that occurs exactly once in its file: a sign, a factor, an index. The tests
named with it run in a copy of the project in a temporary folder, and the first that fails is
named. Ends with exit code 1 where a fault survives, or where the tests fail without one.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]


class Fault(NamedTuple):
    """What is wrong with it; its file; the text and what replaces it; the tests to run."""

    what: str
    file: str
    text: str
    wrong: str
    tests: str


FAULTS = (
    Fault(
        "quaternion product, a sign",
        "Quaternion.py",
        "aw * by - ax * bz",
        "aw * by + ax * bz",
        "quaternion",
    ),
    Fault(
        "exponential of small angles, a factor",
        "Quaternion.py",
        "isSmall, 1.0 - angle * angle / 6.0",
        "isSmall, 1.0 - angle * angle / 2.0",
        "quaternion",
    ),
    Fault(
        "exponential of a small angle, a factor",
        "Quaternion.py",
        "sinc = 1.0 - angle * angle / 6.0",
        "sinc = 1.0 - angle * angle / 2.0",
        "forms",
    ),
    Fault("rotation matrix, a sign", "Quaternion.py", "yz - wx", "yz + wx", "quaternion"),
    Fault(
        "semi-implicit Euler, half angle",
        "RBSFunctions.py",
        "scale(0.5, scale(h",
        "scale(1.0, scale(h",
        "timestep",
    ),
    Fault(
        "semi-implicit Euler in tables, half angle",
        "rbs/stepping/bodies.py",
        "(0.5 * angle)",
        "(1.0 * angle)",
        "forms",
    ),
    Fault(
        "inertia of a tetrahedron, a factor",
        "RBSFunctions.py",
        "volumes[:, None, None] / 20.0",
        "volumes[:, None, None] / 120.0",
        "mesh",
    ),
    Fault(
        "rotated inertia, swapped entries",
        "rbs/geometry/triples.py",
        "xy, yy, yz, xz, yz, zz)",
        "xy, zz, yz, xz, yz, yy)",
        "mesh",
    ),
    Fault(
        "velocity of a point, swapped factors",
        "RBSFunctions.py",
        "cross(body1.angVelocity, r1)",
        "cross(r1, body1.angVelocity)",
        "timestep",
    ),
    Fault(
        "velocities of points in arrays, swapped factors",
        "rbs/stepping/kernels.py",
        "cross(velocity[3:], arms)",
        "cross(arms, velocity[3:])",
        "forms",
    ),
    Fault("restitution, a sign", "RBSFunctions.py", "(1.0 + e)", "(1.0 - e)", "timestep"),
    Fault(
        "inverse effective mass at a contact, a sign",
        "RBSFunctions.py",
        "body.invMass + dot(rCrossN, turning)",
        "body.invMass - dot(rCrossN, turning)",
        "timestep",
    ),
    Fault(
        "position correction, the other weight",
        "RBSFunctions.py",
        "-(invMass1 / total * distance)",
        "-(invMass2 / total * distance)",
        "timestep",
    ),
    Fault(
        "friction across the normal, a sign",
        "RBSFunctions.py",
        "mul_add(u, -dot(u, n), n)",
        "mul_add(u, dot(u, n), n)",
        "friction",
    ),
    Fault(
        "friction within its cone, no limit",
        "RBSFunctions.py",
        "r1, r2, n, mu * j)",
        "r1, r2, n, 1.0 * j)",
        "friction",
    ),
    Fault(
        "friction of many contacts, no limit",
        "rbs/stepping/kernels.py",
        "np.minimum(speed / K, np.maximum(limit, 0.0) + 0.0)",
        "speed / K",
        "forms",
    ),
    Fault(
        "lower bound of a constraint, a sign",
        "RBSFunctions.py",
        "else C < -tolerance",
        "else C < tolerance",
        "constraints",
    ),
    Fault(
        "constraint without a direction, a sign",
        "RBSFunctions.py",
        "COINCIDENT_DIRECTION = (0.0, 1.0",
        "COINCIDENT_DIRECTION = (0.0, -1.0",
        "constraints",
    ),
    Fault(
        "constraints without a direction in arrays, a sign",
        "rbs/stepping/kernels.py",
        "[[0.0], [1.0], [0.0]]",
        "[[0.0], [-1.0], [0.0]]",
        "forms",
    ),
    Fault(
        "support function, the wrong end",
        "GJK.py",
        "dot(v, vertices2).argmax()",
        "dot(v, vertices2).argmin()",
        "gjk",
    ),
    Fault(
        "facets that may become the nearest, half the margin",
        "rbs/geometry/facets.py",
        "extra = 2.0 * margin",
        "extra = 1.0 * margin",
        "facets",
    ),
    Fault(
        "faces above one point, all left out",
        "rbs/geometry/facets.py",
        "(first <= bound) & (second <= bound)",
        "(first <= bound) & (first > second)",
        "facets",
    ),
    Fault(
        "edges, one of their faces is asked",
        "rbs/geometry/facets.py",
        "(nearOne | nearOther) == 0b111",
        "(nearOne & nearOther) == 0b111",
        "facets",
    ),
    Fault(
        "crossing arcs, antipodes too",
        "rbs/geometry/facets.py",
        "& (s[0] * r[1] > 0)",
        "& (s[0] * r[1] != 0)",
        "gjk",
    ),
    Fault(
        "approximate supports, rotated the wrong way",
        "rbs/geometry/hulls.py",
        "mat_vec(inverse, directions)",
        "mat_vec(transpose(inverse), directions)",
        "facets",
    ),
    Fault(
        "contact at a vertex, a sign",
        "rbs/geometry/patches.py",
        "self.level - dot(n, a0)",
        "self.level + dot(n, a0)",
        "gjk",
    ),
    Fault(
        "clipping of the patch, a sign",
        "rbs/geometry/patches.py",
        "(insideB[crosses] - headA[crosses])",
        "(insideB[crosses] + headA[crosses])",
        "gjk",
    ),
    Fault(
        "clipping, what lies beyond the end of an edge in line stays",
        "rbs/geometry/patches.py",
        "isWithin.all(axis=0)",
        "isWithin.all(axis=0) | True",
        "corners",
    ),
    Fault(
        "centroid of the patch, a factor",
        "rbs/geometry/patches.py",
        "moment / (3.0 *",
        "moment / (2.0 *",
        "gjk",
    ),
    Fault(
        "order around a polygon, two of the quarters",
        "rbs/geometry/hulls.py",
        "np.copysign(1.0 - du /",
        "np.copysign(du /",
        "gjk softstep",
    ),
    Fault(
        "boxes of hulls, the wrong extreme",
        "rbs/geometry/hulls.py",
        "for extreme in (np.minimum, np.maximum)",
        "for extreme in (np.minimum, np.minimum)",
        "broadPhase",
    ),
    Fault(
        "box of one hull, the wrong extreme",
        "RBSFunctions.py",
        "hullVertices.max(axis=1)",
        "hullVertices.min(axis=1)",
        "timestep",
    ),
    Fault(
        "facets, faces of the second hull are not turned round",
        "rbs/geometry/facets.py",
        "np.where(row < half, 1.0, -1.0)",
        "np.where(row < half, 1.0, 1.0)",
        "gjk",
    ),
    Fault(
        "impulses of a batch, the wrong body's position",
        "rbs/stepping/gridstep.py",
        "[:, None] - contacts.after\n",
        "[:, None] - contacts.before\n",
        "broadPhase",
    ),
    Fault(
        "missed pairs, the margin of one body only",
        "rbs/stepping/batches.py",
        "(displacement[i] + displacement[j] >= self.gap)",
        "(displacement[i] >= self.gap)",
        "broadPhase",
    ),
    Fault(
        "cached axis, its sign",
        "GJK.py",
        "lowest + dot(axis, t) - highest",
        "highest - lowest - dot(axis, t)",
        "timestep",
    ),
    Fault(
        "kept box, the orientation is not looked at",
        "RBSFunctions.py",
        "            or self.orientation.tobytes() != self._orientationKey\n",
        "",
        "mesh",
    ),
    Fault(
        "queue, what depends on the second body stays clean",
        "rbs/stepping/constraints.py",
        "for b in constraints[c]:",
        "for b in constraints[c][:1]:",
        "constraints",
    ),
    Fault(
        "reduction to four points, the wrong side",
        "rbs/softstep/manifolds.py",
        "np.where(areas[third] < 0, 1.0, -1.0)",
        "np.where(areas[third] < 0, -1.0, 1.0)",
        "softstep",
    ),
    Fault(
        "normal at a ridge, a sign",
        "rbs/softstep/manifolds.py",
        "normal[:, ridge] + weight[other]",
        "normal[:, ridge] - weight[other]",
        "softstep",
    ),
    Fault(
        "waking, a lost contact wakes nobody",
        "rbs/softstep/sleeping.py",
        "isStirred[lost] = True",
        "isStirred[lost] = False",
        "softstep",
    ),
    Fault(
        "soft contact, a coefficient",
        "rbs/softstep/springs.py",
        "a2 = self._angle * a1",
        "a2 = self._angle",
        "softstep",
    ),
    Fault(
        "friction of a manifold, no coefficient",
        "rbs/softstep/contacts.py",
        "self.limits = self.mu * np.stack(",
        "self.limits = np.stack(",
        "softstep",
    ),
    Fault(
        "restitution, the fall within the step",
        "rbs/softstep/contacts.py",
        "speed * speed + gain",
        "speed * speed",
        "softstep",
    ),
    Fault(
        "soft distance constraint, the sign of the second body",
        "rbs/softstep/softconstraints.py",
        "np.concatenate((d, -d), axis=1)",
        "np.concatenate((d, d), axis=1)",
        "softstep",
    ),
    Fault(
        "points of a manifold, those that can touch within the step are left out",
        "rbs/softstep/manifolds.py",
        "np.maximum(CULL * size, reach)",
        "CULL * size",
        "softstep",
    ),
    Fault(
        "motion of a point against the ground, a sign",
        "rbs/softstep/manifolds.py",
        "take(turn[2], row) * x - take",
        "take(turn[2], row) * x + take",
        "softstep",
    ),
    Fault(
        "impulses of the substep before, a part of them",
        "rbs/softstep/contacts.py",
        "(self.B * self.impulse).sum(axis=1)",
        "(0.5 * self.B * self.impulse).sum(axis=1)",
        "softstep",
    ),
    Fault(
        "second sweep of a hit, left out",
        "rbs/softstep/step.py",
        "if contacts.are_hit():",
        "if False:",
        "softstep",
    ),
    Fault(
        "growth of impulses, no limit",
        "rbs/softstep/contacts.py",
        "np.minimum(self.impulse, limit)",
        "self.impulse",
        "scenesRest",
    ),
    Fault(
        "penetration, pushed out as fast as springs do it",
        "rbs/softstep/contacts.py",
        "self.spring.rate * self.separation, -self.push)",
        "self.spring.rate * self.separation, -np.inf)",
        "softstep",
    ),
    Fault(
        "sleeping, what starts to slide",
        "rbs/softstep/sleeping.py",
        "(isStarting | (timer < SLEEP_SECONDS))",
        "(timer < SLEEP_SECONDS)",
        "softstep",
    ),
    Fault(
        "restitution, whatever energy it asks for",
        "rbs/softstep/contacts.py",
        "np.where(a + b > left,",
        "np.where(a + b > np.inf,",
        "softstep",
    ),
    Fault(
        "validity of facets, the way moved is left out",
        "rbs/geometry/facets.py",
        "penetration + norm(shift) <= self",
        "penetration <= self",
        "broadPhase",
    ),
)


def first_failure(folder, names):
    """The first test of tests/test_<name>.py that fails in a copy of the project, or ""."""
    files = [str(next(ROOT.glob(f"tests/*/test_{name}.py"))) for name in names.split()]
    process = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *files],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", process.stdout, re.MULTILINE)
    if (process.returncode != 0) != bool(failed):
        raise RuntimeError(f"pytest ended otherwise than expected:\n{process.stdout[-2000:]}")
    return failed[1] if failed else ""


def try_fault(fault):
    """Runs the tests with a fault, None for none, in a temporary copy; the first that fails."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        copy.mkdir()
        for path in [*ROOT.glob("*.py"), ROOT / "pyproject.toml"]:
            shutil.copy(path, copy)
        for name in ("rbs", "data", "graders", "tests"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        if fault is None:
            return first_failure(copy, " ".join(sorted({fault.tests for fault in FAULTS})))
        source = (copy / fault.file).read_text(encoding="utf-8")
        if source.count(fault.text) != 1:
            raise ValueError(f"{fault.file} has {source.count(fault.text)} times: {fault.text}")
        changed = source.replace(fault.text, fault.wrong)
        (copy / fault.file).write_text(changed, encoding="utf-8")
        return first_failure(copy, fault.tests)


def main():
    chosen = [int(word) for word in sys.argv[1:]] or range(1, len(FAULTS) + 1)
    survived = 0
    for number in chosen:
        fault = FAULTS[number - 1]
        failed = try_fault(fault)
        survived += not failed
        print(f"{number:2} {fault.file:16} {fault.what:42} {failed or 'SURVIVED'}", flush=True)
    if len(sys.argv) == 1 and (failed := try_fault(None)):
        print(f"without a fault, {failed} fails")
        return 1
    return int(survived > 0)


if __name__ == "__main__":
    sys.exit(main())
