"""Calls what is graded, sample by sample, and collects the numbers, whatever the calls do.

From the top: `Bodies`; the calls of the three graders; `answer`.
"""

import copy
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import numpy as np

from rbs.program.returned import RETURNED, NotWritten, WrongResult, by_mesh, numbers, returned
from rbs.program.submissions import POSITION, VELOCITY, built, describe

LISTS = "{} gives lists where run_timestep needs arrays: in a scene, the next step fails"
IN_PLACE = (
    f"{POSITION} changes its arguments in place: the released grader calls it for the upper and "
    "then for the lower bound, with the same arrays"
)


def widths(shapes):
    """Returns pairs (quantity, how many numbers it has); a bool counts as one number."""
    return [(key, 1 if width == "bool" else width) for key, width in shapes.items()]


class Bodies:
    """Makes meshes of the class that is graded: one of each kind, and copies, which take the state
    of a sample. Building each anew takes much longer.

    functions, quaternion : the graded modules RBSFunctions and Quaternion
    meshes : dict from "1" and "2" to origVertices, faces, tets
    states : dict from attributes to rows, of mesh 2
    """

    def __init__(self, functions, quaternion, meshes, states):
        self._modules = {"RBSFunctions": functions, "Quaternion": quaternion}
        self.shapes, self._originals = meshes, {}
        self._states = {name: np.array(rows, np.float64) for name, rows in states.items()}
        self._states["orientation"] /= np.linalg.norm(states["orientation"], axis=1)[:, None]

    def function(self, name, module="RBSFunctions"):
        """Returns a graded function. Raises NotWritten if the module lacks it."""
        function = getattr(self._modules[module], name, None)
        if not callable(function):
            raise NotWritten(f"{module}.py has no {name}")
        return function

    def ground(self):
        return built(self.function("Mesh"))

    def results_of(self, mesh):
        """Yields a mesh's state as calls do."""
        for name in self._states:
            yield getattr(mesh, name, None), f"the mesh's {name}"

    def state_of(self, mesh):
        """A mesh's state (13,): position, orientation, linear and angular velocity."""
        both = zip(self.results_of(mesh), self._states.values(), strict=True)
        return np.concatenate([numbers(value, rows.shape[1], what) for (value, what), rows in both])

    def lag(self, mesh):
        """How far currVertices are from where position and orientation place them, (3 V,)."""
        turn = self.function("QRotate", "Quaternion")
        now = np.array(turn(mesh.orientation, mesh.origVertices) + mesh.position, float)
        return numbers(mesh.currVertices, now.size, "the mesh's currVertices") - now.ravel()

    def resting(self, k="1", isFixed=False):
        """A mesh at rest and unturned, with its COM at the origin."""
        if (k, isFixed) not in self._originals:
            self._originals[k, isFixed] = self._built(k, isFixed)
        try:
            return copy.deepcopy(self._originals[k, isFixed])
        except Exception:  # a student's attributes can be anything
            return self._built(k, isFixed)

    def moving(self, sample, isFixed=False):
        return self.placed(self.resting("2", isFixed), sample, isFixed)

    def placed(self, mesh, sample, isFixed=False):
        """Mesh 2 in the random state of a sample; a fixed one has no velocity."""
        x, q, v, w = (rows[[sample]] for rows in self._states.values())
        turn = self.function("QRotate", "Quaternion")
        vertices = turn(q, np.array(mesh.origVertices)) + x
        mesh.position, mesh.orientation = x, q
        if not isFixed:
            mesh.linVelocity, mesh.angVelocity = v, w
        with suppress(AttributeError):  # of a property
            mesh.currVertices = vertices
        return mesh

    def _built(self, k, isFixed):
        return built(self.function("Mesh"), f"mesh {k}", *self.shapes[k], 1.0, isFixed=isFixed)


# Each call is given Bodies, and the inputs of a sample: `index`, and those of its part. It yields
# the quantities, in order: value or Exception, and a name for messages, or "".


def integrate(bodies, s):
    mesh = bodies.moving(s.index)
    for timeStep in (s.timeStep, s.secondStep):
        if timeStep:
            mesh.integrate_timestep(timeStep)
    yield from bodies.results_of(mesh)


def integrate_further(bodies, s):
    fixed = bodies.moving(s.index, isFixed=True)
    fixed.integrate_timestep(s.timeStep)
    yield bodies.state_of(fixed)[:7], ""
    mesh = bodies.moving(s.index)
    mesh.integrate_timestep(s.timeStep)
    yield bodies.lag(mesh), ""


def rotate_tensor(bodies, s):
    """Asks at rest first: a tensor that is kept is wrong then."""
    mesh = bodies.resting("2")
    mesh.get_rotated_inv_IT()
    tensor = bodies.placed(mesh, s.index).get_rotated_inv_IT()
    yield numbers(tensor, 9, "rotated inverse inertia") / s.unit, ""


def contact_of(s):
    return s.depth, s.intNormal.copy(), s.intPosition.copy(), s.restitution


def resolve(bodies, s):
    """Leaves the meshes as they are in samples without a collision."""
    meshes = bodies.resting(), bodies.moving(s.index)
    if s.isCollision:
        bodies.function("resolve_collision")(*meshes, *contact_of(s))
    for pair in zip(*map(bodies.results_of, meshes), strict=True):
        yield from pair


def resolve_further(bodies, s):
    """Resolves with a fixed mesh, and with the ground, where the depth is negative."""
    fixed, mesh = bodies.resting(isFixed=True), bodies.moving(s.index)
    bodies.function("resolve_collision")(fixed, mesh, *contact_of(s))
    yield bodies.state_of(fixed), ""
    lower = bodies.moving(s.index)
    contact = -s.depth, np.array([[0.0, 1.0, 0.0]]), s.intPosition.copy(), s.groundRestitution
    bodies.function("resolve_collision")(lower, bodies.ground(), *contact)
    yield bodies.state_of(lower), ""
    gaps = (bodies.lag(one).reshape(-1, 3) for one in (mesh, lower))
    yield max(np.linalg.norm(gap, axis=1).max() for gap in gaps), ""


def constrained(bodies, s):
    """Returns the two meshes, [their positions, the world positions of the linked points].

    As in the released grader, both points are rest vertex 0 of mesh 1, carried along by either.
    """
    meshes = bodies.resting(), bodies.moving(s.index)
    rotate = bodies.function("QRotate", "Quaternion")
    restPoint = np.array(meshes[0].origVertices[:1])
    turned = [rotate(mesh.orientation, restPoint.copy()) for mesh in meshes]
    pairs = zip(turned, meshes, strict=True)
    points = tuple(np.reshape(point, (1, 3)) + mesh.position for point, mesh in pairs)
    return meshes, [tuple(mesh.position for mesh in meshes), points]


def resolved(bodies, s, bound, tolerance, arrays=None, invMasses=None):
    """The values that `resolve_position_constraint` returns."""
    meshes, new = constrained(bodies, s)
    refValue = float(getattr(s, f"{bound.lower()}Value")[0])  # a float, as run_timestep gives it
    given = refValue, invMasses or tuple(mesh.invMass for mesh in meshes), bound == "Upper"
    values = bodies.function(POSITION)(*arrays or new, *given, float(tolerance))
    return returned(values, POSITION)


def resolve_positions(bodies, s):
    arrays = constrained(bodies, s)[1]
    before = [array.copy() for pair in arrays for array in pair]
    for bound in ("Upper", "Lower"):
        wasValid, corrected = resolved(bodies, s, bound, s.tolerance, arrays)
        yield wasValid, ""
        if not all(map(np.array_equal, before, (array for pair in arrays for array in pair))):
            corrected = [WrongResult(IN_PLACE)] * 2
        yield from by_mesh(f"correctedPositions{bound}", corrected)


def check_tolerances(bodies, s):
    for bound in ("Upper", "Lower"):
        for place in ("within", "beyond"):
            yield resolved(bodies, s, bound, getattr(s, place + bound))[0], ""
    yield resolved(bodies, s, "Upper", s.withinUpper, invMasses=(0.0, 0.0))[0], ""


def resolved_velocities(bodies, s, tolerance):
    meshes, arrays = constrained(bodies, s)
    for name in ("linVelocity", "angVelocity", "invMass"):
        arrays.append(tuple(getattr(mesh, name) for mesh in meshes))
    arrays.append((s.tensors[0].copy(), s.tensors[1].copy()))
    return returned(bodies.function(VELOCITY)(*arrays, tolerance), VELOCITY)


def resolve_velocities(bodies, s):
    wasValid, *pairs = resolved_velocities(bodies, s, s.tolerance)
    yield wasValid, ""
    for key, pair in zip(list(RETURNED[VELOCITY])[1:], pairs, strict=True):
        yield from by_mesh(key, pair)


def check_velocity_tolerance(bodies, s):
    for tolerance in (s.within, s.beyond):
        yield resolved_velocities(bodies, s, float(tolerance))[0], ""


CALLS = (integrate, integrate_further, rotate_tensor, resolve, resolve_further)
CALLS += (resolve_positions, check_tolerances, resolve_velocities)
CALLS = {one.__name__: one for one in (*CALLS, check_velocity_tolerance)}


class Answer:
    """Numbers of the samples, NaN where a number is missing, and the causes.

    values : dict from quantity to list of rows
    problems : dict from quantity to (cause, number of samples, first sample)
    """

    def __init__(self, order, folder):
        count, shapes = len(order["samples"]), order["shapes"]
        self.values = {key: np.full((count, width), np.nan) for key, width in widths(shapes)}
        self.problems, self.remarks, self._folder = {}, {}, folder

    @contextmanager
    def attempt(self, sample, keys):
        """Context in which any exception becomes the problem of these quantities."""
        try:
            yield
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:  # not even SystemExit ends the process
            cause = str(error)
            if not isinstance(error, WrongResult):
                cause = describe(error, self._folder)
            if isinstance(error, NotWritten | NotImplementedError):
                cause = f"not implemented: {cause}"
            for key in keys:
                known, count, first = self.problems.get(key, (cause, 0, int(sample)))
                self.problems[key] = known, count + 1, first


def answer(order, functions, quaternion, folder):
    """Returns the numbers of a part, as JSON can hold them.

    order : "call", a name of CALLS; "function"; "shapes", dict from quantity to how many numbers it
        has, or "bool"; "samples"; "inputs", dict from name to a row for each sample, or to one
        number; and what Bodies are made of
    folder : of the student's modules; causes name files relative to it
    """
    bodies = Bodies(functions, quaternion, order["meshes"], order["states"])
    result, shapes = Answer(order, folder), order["shapes"]
    for row, sample in enumerate(order["samples"]):
        given = {k: v[row] if isinstance(v, list) else v for k, v in order["inputs"].items()}
        given = {k: np.array(v, float) if isinstance(v, list) else v for k, v in given.items()}
        missing = list(shapes)
        # Numbers that overflow or are NaN show in the table.
        with result.attempt(sample, missing), np.errstate(all="ignore"):
            call = CALLS[order["call"]](bodies, SimpleNamespace(index=sample, **given))
            for value, what in call:
                key = missing.pop(0)
                if isinstance(value, list):
                    result.remarks[LISTS.format(order["function"])] = None
                with result.attempt(sample, [key]):
                    if isinstance(value, Exception):
                        raise value
                    result.values[key][row] = numbers(value, shapes[key], what or key)
    values = {key: rows.tolist() for key, rows in result.values.items()}
    told = {"problems": result.problems, "remarks": list(result.remarks)}
    return {"values": values, "inertia": inertia(bodies)} | told


def inertia(bodies):
    """Returns mesh 2's inverse inertia tensor, and in world axes in the first sample; in world axes
    that of mesh 1, that of mesh 1 if it is fixed, and the ground's.
    """
    found = []
    with suppress(BaseException), np.errstate(all="ignore"):
        mesh = bodies.moving(0)
        found.append(numbers(mesh.invIT, 9, "invIT").tolist())
        others = bodies.resting, lambda: bodies.resting(isFixed=True), bodies.ground
        for one in (mesh, *(make() for make in others if "1" in bodies.shapes)):
            found.append(numbers(one.get_rotated_inv_IT(), 9, "tensor").tolist())
    return found
