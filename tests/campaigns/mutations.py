"""Puts one-line faults into copies of the code and checks whether a test notices each.

    python tests/campaigns/mutations.py                     all faults, one line of output each
    python tests/campaigns/mutations.py rbs/window 3 8      those in such files, and these by number
    python tests/campaigns/mutations.py --jobs 2            two at a time

A fault replaces a text that occurs exactly once in its file: a sign, a factor, an index. The tests
named with it run in a copy of the project in a temporary folder, and the first that fails is
named. Ends with exit code 1 if a fault survives, or if the tests fail without one.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]


class Fault(NamedTuple):
    file: str
    what: str
    tests: str  # those that must notice it
    text: str
    wrong: str


# Two lines each: file, fault and tests that must notice it; text and replacement.
FAULTS_IN_TEXT = """
Quaternion.py: quaternion product, a sign (quaternion)
    aw * by - ax * bz -> aw * by + ax * bz
Quaternion.py: exponential of small angles, a factor (quaternion)
    isSmall, 1.0 - angle * angle / 6.0 -> isSmall, 1.0 - angle * angle / 2.0
Quaternion.py: exponential of a small angle, a factor (forms)
    sinc = 1.0 - angle * angle / 6.0 -> sinc = 1.0 - angle * angle / 2.0
Quaternion.py: rotation matrix, a sign (quaternion)
    yz - wx -> yz + wx
RBSFunctions.py: semi-implicit Euler, half angle (timestep)
    scale(0.5, scale(h -> scale(1.0, scale(h
rbs/stepping/flight.py: semi-implicit Euler in tables, half angle (forms)
    (0.5 * angle) -> (1.0 * angle)
RBSFunctions.py: inertia of a tetrahedron, a factor (mesh)
    volumes[:, None, None] / 20.0 -> volumes[:, None, None] / 120.0
rbs/geometry/triples.py: rotated inertia, swapped entries (mesh)
    xy, yy, yz, xz, yz, zz -> xy, zz, yz, xz, yz, yy
RBSFunctions.py: velocity of a point, swapped factors (timestep)
    cross(body1.angVelocity, r1) -> cross(r1, body1.angVelocity)
rbs/stepping/kernels.py: velocities of points in arrays, swapped factors (forms)
    cross(velocity[3:], arms) -> cross(arms, velocity[3:])
RBSFunctions.py: restitution, a sign (timestep)
    (1.0 + e) -> (1.0 - e)
RBSFunctions.py: inverse effective mass at a contact, a sign (timestep)
    invMass + dot(rCrossN, response), -> invMass - dot(rCrossN, response),
RBSFunctions.py: position correction, the other weight (timestep)
    -(invMass1 / total * distance) -> -(invMass2 / total * distance)
RBSFunctions.py: friction across the normal, a sign (friction)
    mul_add(u, -dot(u, n), n) -> mul_add(u, dot(u, n), n)
RBSFunctions.py: friction within its cone, no limit (friction)
    r1, r2, n, mu * j) -> r1, r2, n, 1.0 * j)
rbs/stepping/kernels.py: friction of many contacts, no limit (forms)
    np.minimum(speed / K, np.maximum(limit, 0.0) + 0.0) -> speed / K
RBSFunctions.py: lower bound of a constraint, a sign (constraints)
    else C < -tolerance -> else C < tolerance
RBSFunctions.py: constraint without a direction, a sign (constraints)
    if length > 0.0 else UPWARDS -> if length > 0.0 else scale(-1.0, UPWARDS)
rbs/stepping/kernels.py: constraints without a direction in arrays, a sign (forms)
    [[0.0], [1.0], [0.0]] -> [[0.0], [-1.0], [0.0]]
GJK.py: support function, the wrong end (gjk)
    (direction @ vertices2).argmax() -> (direction @ vertices2).argmin()
rbs/geometry/facets.py: facets that may become the nearest, half the margin (facets)
    for x in (2.0 * margin, level) -> for x in (1.0 * margin, level)
rbs/geometry/facets.py: faces above one point, all left out (facets)
    (first <= bound) & (second <= bound) -> (first <= bound) & (first > second)
rbs/geometry/facets.py: edges, one of their faces is asked (facets)
    (nearOne | nearOther) == 0b111 -> (nearOne & nearOther) == 0b111
rbs/geometry/facets.py: crossing arcs in arrays, antipodes too (facets)
    (s[0] * s[1] < 0) & (s[0] * r[1] > 0) -> (s[0] * s[1] < 0)
rbs/geometry/facets.py: pairs of edges of large hulls, all at once (facets)
    in blocks(np.append(count, 0)) -> in [slice(0, len(count))]
rbs/geometry/facets.py: facets up to a level, only those near the nearest (grounds)
    np.maximum(depth + extra, level) -> depth + extra
rbs/geometry/broadphase.py: cells around a box, one is left out (broadPhase)
    np.array([0, 1, stride - 1, -> np.array([0, 1,
rbs/stepping/batches.py: a pass that is made again, only of wrong pairs (broadPhase)
    number + 1 if number else least -> number + 1 if least else 0
GJK.py: crossing arcs, antipodes too (gjk)
    s1 * s2 < 0.0 and s1 * r2 > 0.0 -> s1 * s2 < 0.0
GJK.py: edges that may span a near facet, one of their faces is asked (facets)
    lesser = np.minimum(depths -> lesser = np.maximum(depths
GJK.py: contact at a crossing of edges, a sign (facets)
    dot(across, sub(a0, b0)) / denominator -> dot(across, sub(b0, a0)) / denominator
rbs/geometry/hulls.py: approximate supports, rotated the wrong way (facets)
    = vec_mat(directions, -> = (lambda v, matrix: mat_vec(matrix, v))(directions,
rbs/geometry/patches.py: contact at a vertex, a sign (facets)
    self.level - dot(n, a0) -> self.level + dot(n, a0)
rbs/geometry/patches.py: clipping of the patch, a sign (gjk)
    (insideB[crosses] - headA[crosses]) -> (insideB[crosses] + headA[crosses])
rbs/geometry/patches.py: clipping, what lies beyond the end of an edge in line stays (facets)
    isWithin.all(axis=0) -> isWithin.all(axis=0) | True
rbs/geometry/patches.py: centroid of the patch, a factor (gjk)
    moment / (3.0 * -> moment / (2.0 *
rbs/geometry/hulls.py: order around a polygon, two of the quarters (gjk softstep)
    np.copysign(1.0 - du / -> np.copysign(du /
rbs/stepping/bodies.py: boxes of hulls, the wrong extreme (broadPhase)
    high = np.maximum.reduceat -> high = np.minimum.reduceat
rbs/geometry/hulls.py: box of one hull, the wrong extreme (timestep)
    self.vertices.max(axis=1) -> self.vertices.min(axis=1)
rbs/geometry/facets.py: facets, faces of the second hull are not turned round (facets)
    np.where(row < half, 1.0, -1.0) -> np.where(row < half, 1.0, 1.0)
rbs/stepping/batches.py: normal of the ground, signs of its zeros (broadPhase)
    -np.tile([[0.0], [1.0], [0.0]] -> np.tile([[0.0], [-1.0], [0.0]]
rbs/stepping/batches.py: impulses of a batch, the wrong body's position (broadPhase)
    * n)[:, None] - after -> * n)[:, None] - before
rbs/stepping/batches.py: missed pairs, the displacement of one body only (broadPhase)
    take(self.displacement, self.pairs.second) -> 0.0
GJK.py: cached axis, its sign (timestep)
    if gap > LEAST_GAP * size: -> if -gap > LEAST_GAP * size:
RBSFunctions.py: boxes of a loop, those of bodies that are moved (broadPhase)
    boxes[i], boxes[j] = m1.bounding_box(), m2.bounding_box() -> pass
rbs/geometry/broadphase.py: broad phase, bodies that leave their reach (broadPhase)
    (_column(box) >= reach[:, b]).all() -> True
RBSFunctions.py: Jacobian of a constraint, a sign (constraints)
    - dot(n, v2) - dot(r2CrossN, omega2) -> - dot(n, v2) + dot(r2CrossN, omega2)
rbs/stepping/constraints.py: queue, what depends on the second body stays clean (constraints)
    dirty |= linksOf[b] -> dirty |= linksOf[movable[k][0]]
rbs/stepping/constraints.py: sweep, the second bound of a link in no count (constraints)
    visits += len(link.bounds) -> visits += 1
rbs/stepping/constraints.py: the last sweep, whole (constraints)
    if not links or links[-1].bounds[-1].index < end: -> if True:
rbs/stepping/constraints.py: batches, impossible constraints in no count (constraints)
    - begin - (rows.total - len(rows.index)) -> - begin
rbs/softstep/manifolds.py: reduction to four points, the wrong side (softstep)
    np.where(areas[third] < 0, 1.0, -1.0) -> np.where(areas[third] < 0, -1.0, 1.0)
rbs/softstep/manifolds.py: normal of a contact, the facet that closes first (grounds)
    row_minima(-time, count -> row_minima(time, count
rbs/softstep/sleeping.py: waking, a lost support wakes no body (grounds)
    isShaken = (isBereft | beside( -> isShaken = (beside(
rbs/softstep/springs.py: soft contact, a coefficient (softstep)
    a2 = angle * a1 -> a2 = angle
rbs/softstep/rows.py: split masses, more than the whole (softstep)
    np.maximum(count / RELAXATION, 1.0) -> count / RELAXATION
rbs/softstep/rows.py: friction of a manifold, no coefficient (softstep)
    mu * isPoint * np.sqrt -> isPoint * np.sqrt
rbs/softstep/rows.py: friction of points that slide, the spin left out (experiments)
    self.levers[1:3] * w[2] -> 0.0
rbs/softstep/contacts.py: restitution, the fall within the step (softstep)
    speed * speed + gain -> speed * speed
rbs/softstep/softconstraints.py: soft distance constraint, the sign of the second body (softstep)
    np.concatenate((d, -d), axis=1) -> np.concatenate((d, d), axis=1)
rbs/softstep/manifolds.py: points that can touch within the step, left out (softstep)
    np.maximum(CULL * size, reach) -> CULL * size
rbs/softstep/detection.py: approach within the step, a sign (softstep)
    advance -= np.minimum( -> advance += np.minimum(
rbs/softstep/manifolds.py: motion of a point against the ground, a sign (softstep)
    take(turn[2], row) * x - take -> take(turn[2], row) * x + take
rbs/softstep/contacts.py: impulses of the substep before, a part of them (softstep)
    self.pending + self.impulse -> self.pending + 0.5 * self.impulse
rbs/softstep/manifolds.py: points that are apart, as good as others (softstep)
    np.inf, -weight * measure) -> np.inf, -measure)
rbs/softstep/manifolds.py: points of bodies that overlap deeply, left out (grounds)
    np.maximum(separation[first], 0.0) -> separation[first]
rbs/softstep/supports.py: supports that cross, no matter (grounds)
    axis=1)) < CROSSING -> axis=1)) < -2.0
rbs/softstep/detection.py: boxes of bodies that others pull, not larger (softstep)
    + pull[:-1] -> + 0.0
rbs/softstep/contacts.py: growth of impulses, no limit (experiments)
    np.minimum(normal, np.maximum(LOAD_GROWTH * before, self.least)) -> normal
rbs/softstep/contacts.py: penetration, pushed out as fast as springs do it (softstep)
    np.maximum(np.maximum(wanted, self.push), approach) -> np.maximum(wanted, approach)
rbs/softstep/sleeping.py: sleeping, what starts to slide (grounds)
    isSteady & (timer >= -> True & (timer >=
rbs/softstep/rows.py: blows, all at the point that is visited first (experiments)
    self.shared, error) -> 0.0 * self.shared, error)
rbs/softstep/energies.py: restitution, whatever energy it asks for (softstep)
    isOver = isBound & (energy > limit) -> isOver = isBound & (energy > np.inf)
rbs/softstep/supports.py: seams, planes whatever rises above them (grounds)
    farthest <= slack -> farthest <= np.inf
rbs/softstep/contacts.py: plastic blows, as the substeps left them (grounds)
    if CRCoeff < 1.0 else self.total -> if CRCoeff < 0.0 else self.total
rbs/softstep/sleeping.py: a removed support, loads that stay (grounds)
    rows = indices(free[lower] | -> rows = indices((free[lower] & False) |
rbs/softstep/detection.py: frames, the motion of the whole island counts (grounds)
    if isFree[near].any(): -> if False:
rbs/softstep/sleeping.py: sleepers in the way of a blow, walls (experiments)
    ~isAwake & reached( -> isAwake & reached(
rbs/softstep/sleeping.py: sleepers that are pushed, not felt (experiments)
    reached(force, mass -> reached(0.0 * force, mass
rbs/softstep/sleeping.py: what glides, at rest (experiments)
    - slower), _speeds(bodies, slower) -> - slower), 0.0
rbs/softstep/contacts.py: substeps of another length, one sweep (experiments)
    if ratio <= 1.0 else np.arange(self.count) -> if ratio >= 0.0 else np.arange(self.count)
rbs/softstep/contacts.py: heavy loads, springs yield to all (experiments)
    return MOST_LOAD * np -> return 1e9 * np
rbs/softstep/contacts.py: blows, repeated in the next step (grounds)
    self.impulse[:, some] = take(begun, some, 1) -> pass
rbs/softstep/rows.py: plastic blows, no farther than the bodies struck (experiments)
    if not isReached.any(): -> if True:
rbs/softstep/rows.py: friction of points that slide, as of those that stick (experiments)
    isFast & (contacts.fall > 0.0) -> isFast & (contacts.fall < 0.0)
rbs/stepping/batches.py: validity of facets, the way moved is left out (broadPhase)
    contacts.depth + shift > self -> contacts.depth > self
rbs/stepping/batches.py: a pass that is made again, from where the last one ended (broadPhase)
    bodies.position[:] = self._positions(contacts, everybody, len(self.keys)) -> pass
rbs/stepping/batches.py: checks of a pass, positions at the end (broadPhase)
    event[order].searchsorted(b * width + rank -> event[order].searchsorted(b * width + width - 1
rbs/stepping/bodies.py: states in tables, what a caller assigns is not looked at (mesh)
    if name in mesh.__dict__] -> if False]
rbs/softstep/detection.py: near pairs, a fixed body that is moved (softstep)
    grid_overlaps(self.box, isStill) -> grid_overlaps(self.box, isStill | self.bodies.isFixed)
rbs/softstep/detection.py: manifolds on the ground, kept as long as others (softstep)
    np.where(isOnGround, KEEP_ON_GROUND, KEEP) -> KEEP
rbs/scenes/files.py: partial files, one that exists is taken (writing)
    with suppress(FileExistsError), named_errors(path): -> with named_errors(path):
rbs/scenes/files.py: devices, replaced by files (writing)
    if os.path.exists(target) and not os.path.isfile(target): -> if False:
rbs/scenes/files.py: outputs, over what the run reads (badInput)
    if target in taken: -> if False:
rbs/scenes/files.py: old file, gone before the new one is whole (writing)
    os.replace(partial, target) -> partial.unlink()
rbs/scenes/messages.py: messages, with characters that move the cursor (writers)
    if c.isprintable() else -> if True else
rbs/scenes/messages.py: messages, cut off without a sign (writers)
    text[: limit - 3] + "..." -> text[:limit]
rbs/scenes/textfiles.py: whole numbers, with the digits of any script (badInput)
    raise ValueError(f"not a number: {text!r}") -> pass
rbs/scenes/textfiles.py: text files, a byte-order mark is a character (loading)
    decode("utf-8-sig", "replace") -> decode("utf-8", "replace")
rbs/scenes/textfiles.py: text files, what follows the last row (loading)
    if not self.at_end(): -> if False:
rbs/scenes/textfiles.py: numbers, infinite ones (loading)
    if not math.isfinite(value): -> if False:
rbs/scenes/meshfiles.py: corners counted backwards, from the first vertex (loading)
    else len(vertices) + n for -> else -n - 1 for
rbs/geometry/surfaces.py: corners within the rounding of a file, apart (loading)
    for tolerance in (0.0, 2.0 -> for tolerance in (0.0, 0.0
rbs/geometry/surfaces.py: rounding of a file, a thousand times as much (loading)
    10.0 ** (1 - digits) -> 10.0 ** (4 - digits)
rbs/scenes/meshfiles.py: polygons of a PLY file, by the length of the first (loading)
    form = f"{order}{length} -> length = min(length, 4); form = f"{order}{length}
rbs/scenes/textfiles.py: UTF-16, not told (loading)
    if content.startswith(UTF16_MARKS): -> if False:
rbs/stepping/meshes.py: inertia that is not symmetric, taken (pythonInterface)
    return bool(isSymmetric and -> return bool(
rbs/stepping/settings.py: gravity upwards, as a number (settings)
    (0.0, 1e6), -> (-1e6, 1e6),
rbs/stepping/reports.py: no ground, there is one (pythonInterface)
    groundMesh = groundMesh if self.ground else None -> pass
rbs/scenes/simulation.py: time, summed up (pythonInterface)
    isMultiple = self.time == steps * settings.timeStep -> isMultiple = False
rbs/scenes/state.py: several bodies taken from the list, the first ones (keeping)
    removed.append(kept) -> removed.append(0)
rbs/recordings/replay.py: settings of a recording, changed (pythonInterface)
    if name in vars(self): -> if False:
rbs/recordings/outputs.py: a run that breaks off, in the place of an older one (keeping)
    if not isWhole and self.partial != self.target -> if False
rbs/recordings/recording.py: a full disk, without a reserve (writing)
    self._file.id.get_filesize() + size + SPARE_BYTES -> 0
rbs/scenes/meshfiles.py: faces of two tetrahedra, on the surface too (loading)
    sides[~np.isin(keys(sides), keys(sides[:, ::-1]))] -> sides
rbs/scenes/scenefiles.py: millimetres in a scene, metres (loading)
    vertices * float(scale or 1.0) -> vertices * 1.0
rbs/scenes/simulation.py: recommended switches, the default (suggestions)
    value = not one.default if -> value = one.default if
rbs/scenes/simulation.py: recommended settings, used although ignored (suggestions)
    {} if isBasic else recommended_values -> recommended_values
rbs/scenes/simulation.py: settings to return to, those of the coursework (suggestions)
    simulation.startSettings = replace(simulation.settings) -> pass
rbs/scenes/simulation.py: given options in a scene, those that its solver ignores (suggestions)
    given = used_settings(given, chosen -> used_settings(given, chosen
rbs/recordings/lookup.py: list of files, a recording under the name of a scene (commandLine)
    ListedFile(BESIDE, path.name, "a recording" -> ListedFile(BESIDE, path.stem, "a recording"
rbs/recordings/outputs.py: a file that was not saved, left behind (writers)
    remove_partial(self.partial) -> pass
rbs/recordings/outputs.py: a file that is whole, not put in place (writers)
    put_in_place(self.partial, self.target) -> pass
rbs/recordings/outputs.py: total energy, a sign (recording)
    kinetic + potential, -> kinetic - potential,
rbs/recordings/outputs.py: deepest contact, none (recording)
    report.deepest, -> 0.0,
rbs/recordings/outputs.py: an unfinished table, its last row may be a part (writing)
    file.truncate(content.rfind(b"\\n") + 1) -> pass
rbs/recordings/outputs.py: unknown numbers, nan (recording)
    "" if math.isnan(value) else value -> value
rbs/recordings/encoder.py: frames of a video, counted from step 0 (writers)
    (step - self._firstStep) % self.every -> step % self.every
rbs/recordings/encoder.py: frames of a video, twice of one step (writers)
    or step == self._lastStep -> or False
rbs/recordings/encoder.py: a video that lacks frames, taken for whole (writers)
    [0] == self.count: -> [0] >= 0:
rbs/recordings/encoder.py: frame rate, that of a default (writers)
    ["-r", str(Fraction(self.rate).limit_denominator())] -> ["-r", "25"]
rbs/recordings/encoder.py: a video that was not saved, ffmpeg goes on (writers)
    self._frames.throw(KeyboardInterrupt) -> pass
rbs/recordings/poses.py: times of a backward replay, negative (writers)
    return np.abs(np.diff( -> return (np.diff(
rbs/recordings/poses.py: states of one step, twice (writers)
    if self._steps and self._steps[-1] == simulation.stepCount: -> if False:
rbs/recordings/poses.py: quaternions, any sign (writers)
    np.where(turns, -1.0, 1.0) -> np.where(turns, 1.0, 1.0)
rbs/recordings/poses.py: bodies that are removed, there to the end (gltf)
    isThere[::-1].argmax(axis=0) -> 0 * isThere[::-1].argmax(axis=0)
rbs/recordings/poses.py: faces without area, no normal (writers)
    np.linalg.norm(normals, axis=1) < 0.5 -> np.linalg.norm(normals, axis=1) < -1.0
rbs/recordings/gltf.py: rotations, w first (gltf)
    np.roll(orientations[:, b], -1, axis=1) -> orientations[:, b]
rbs/recordings/gltf.py: colours, not linear (page)
    *linear(np.asarray(colour)).tolist(), 1.0 -> *colour, 1.0
rbs/recordings/gltf.py: rods of constraints, half as long (gltf)
    1, length[:, 0], axis=1) -> 1, 0.5 * length[:, 0], axis=1)
rbs/recordings/gltf.py: bounds of times, left out (writers)
    document.accessor(times, isBounded=True) -> document.accessor(times)
rbs/recordings/page.py: names, taken for a template (writers)
    lambda _: f"<title>{texts['[NAME]']}</title>" -> f"<title>{texts['[NAME]']}</title>"
rbs/recordings/page.py: names, as HTML (writers)
    {"[NAME]": html.escape(name), -> {"[NAME]": name,
rbs/program/options.py: options of pictures, refused with a window (commandLine)
    names.add(WINDOW) -> pass
rbs/program/options.py: options that need another, accepted without it (commandLine)
    if one.needs and names.isdisjoint(one.needs): -> if False:
rbs/program/options.py: options that exclude each other, accepted (commandLine)
    if other is not one and not -> if other is one and not
rbs/program/options.py: switches of settings, without effect (commandLine)
    parse = not one.default -> parse = one.default
rbs/program/options.py: several overlays, only the last (commandLine)
    form["action"] = "append" -> pass
rbs/program/parsing.py: negative numbers, taken for options (commandLine)
    re.compile("-[.]?[0-9]") -> re.compile("-[0-9]+$")
rbs/program/parsing.py: numbers, no least one (badInput)
    if not low <= value <= high: -> if not value <= high:
rbs/program/headless.py: exit code of a run with an output that failed (writing)
    or 2 * outputs.haveFailed -> or 0 * outputs.haveFailed
rbs/recordings/outputs.py: outputs, one that fails ends the others (writing)
    self.report(error) -> self.writers.clear()
rbs/program/headless.py: traced step, the one before (traceOption)
    step - 1 - simulation.stepCount -> step - 2 - simulation.stepCount
rbs/program/headless.py: body of a trace, a name that is a number (traceOption)
    if text.isdecimal() and int(text) < len(names): -> if False:
rbs/program/headless.py: exit code of a run that a signal ended (recording)
    return 128 + run.stoppedBy if -> return 129 + run.stoppedBy if
rbs/program/headless.py: energies at the start, those of the end (commandLine)
    rows[name] = f"{begin[name]} -> rows[name] = f"{rows[name]}
rbs/program/results.py: steps of a Python run, one more (pythonInterface)
    for _ in progress(range(count)): -> for _ in progress(range(count + 1)):
rbs/program/results.py: files of a Python run that an error ends, lost (pythonInterface)
    if self.stepCount != begin: -> if False:
rbs/program/results.py: frames from Python, none per step (pythonInterface)
    checked_count(every, "every", 1) -> checked_count(every, "every", 0)
rbs/geometry/triples.py: values in messages, with NumPy's names (pythonInterface)
    value = value.tolist() -> pass
RigidBodySimulation.py: resumed step, always the last (recording)
    if options.from_step is None else options.from_step -> if True else options.from_step
RigidBodySimulation.py: settings of a resumed run, those recorded (recording)
    simulation.settings.changed(**given_values(options, SETTINGS)) -> simulation.settings
RigidBodySimulation.py: every-th step, each step (commandLine)
    every = every or options.every or commandLine.DEFAULT_EVERY -> every = 1
rbs/window/history.py: a pause in drawing, all of it is caught up (timeline)
    self._due + elapsed * self.speed, most) -> self._due + elapsed * self.speed, math.inf)
rbs/window/history.py: moments that are dropped, the start among them (timeline)
    del self.axis[1] -> del self.axis[0]
rbs/window/history.py: memory, no limit (timeline)
    while len(self.axis) > most or -> while
rbs/window/history.py: something new, what was ahead is lost (timeline)
    self._left.append((self.axis, -> self._left.append((self.axis[:first],
rbs/window/history.py: start over, on the same axis (timeline)
    first = 0 if startsOver else self.place + 1 -> first = self.place + 1
rbs/window/history.py: changes of a slider, each by itself (timeline)
    if topic is not None and topic == self._topic -> if False
rbs/window/history.py: redo after a branch, along what was ahead (timeline)
    left, self.axis, place = self._undone.pop() -> left, axis, _ = self._undone.pop()
rbs/window/history.py: gone on from an old moment, the solver starts cold (timeline)
    self._isCold = self.now.solver is None -> self._isCold = False
rbs/window/history.py: what moments share, also after a change (timeline)
    and one.settings == other.settings -> and True
rbs/window/history.py: a step made again, without the pull before it (timeline)
    run.set_state(self._start) -> pass
rbs/window/history.py: jump, any change (glass)
    size > JUMP * np.linalg.norm(fall) > 0.0 -> size > 0.0
rbs/window/history.py: place of a step, the next one (timeline)
    abs(self.axis[place].stepCount - step) -> abs(self.axis[place].stepCount - 1 - step)
rbs/window/history.py: speed that is reached, of the steps wanted (timeline)
    self._played += timeStep -> self._played += elapsed
rbs/window/history.py: a moment that is read, the recording stays there (timeline)
    replay.seek(here) -> pass
rbs/pictures/view.py: without a ground, its floor and shadows (view)
    one.set_enabled(self.simulation.settings.ground) -> pass
rbs/window/plots.py: lower bounds, as upper ones (timeline)
    np.where(upper, gap, -gap) -> np.where(upper, gap, gap)
rbs/window/plots.py: quantities, of fixed bodies too (timeline)
    self._isFree = invMass > 0.0 -> self._isFree = invMass >= 0.0
rbs/window/outputs.py: looking back, ends a recording (timeline)
    and viewer.history.now is not self.moment: -> and True:
rbs/window/outputs.py: a step from the past, recorded as the next (timeline)
    and viewer.history.now is not self.moment: -> and False:
rbs/window/outputs.py: what is gone through again, not recorded (timeline)
    if moment is not before or history.now is before -> if True
rbs/window/viewer.py: start over, with the present settings (timeline)
    kept = simulation.startSettings if withSettings else -> kept = None if False else
rbs/pictures/viewpoint.py: fit in view, with what has left it (view)
    reach = max(high - low) -> reach = 1e9
rbs/pictures/viewpoint.py: first view, also if the scene is seen (view)
    & (pixels < ends)).all(axis=1).any(): -> & (pixels < ends)).all():
rbs/pictures/view.py: a body that is added, others change colours (view)
    self._colourIndex.setdefault(id(mesh), (len( -> self._colourIndex.setdefault(id(mesh), (-len(
rbs/recordings/encoder.py: films, one frame for each call (view)
    if (due := int(seconds * self.rate) + 1 - self.count) > 0: -> if due := 1:
rbs/program/submittedsteps.py: a loop without end, not stopped (submittedSteps)
    timer.start() -> timer.cancel()
rbs/window/hand.py: balls, more than the limit (timeline)
    >= MOST_SHOTS: -> >= 2 * MOST_SHOTS:
rbs/window/glass.py: next event, the same again (glass)
    way * (k - self.place) > 0] -> way * (k - self.place) >= 0]
rbs/window/glass.py: constraints that hold, gone through (glass)
    if not one or k == self.place] -> if True]
rbs/window/panel.py: redo, undo (timeline)
    "redo", viewer.redo) -> "redo", viewer.step_back)
rbs/window/panel.py: events, backwards (glass)
    partial(go, -1) -> partial(go, 1)
rbs/appearance/camera.py: frames in real time, twice as many (view)
    round(1.0 / (VIDEO_RATE * timeStep)) -> round(0.5 / (VIDEO_RATE * timeStep))
graders/classwork/marks.py: what a stub gets right, counts (cheats)
    if one[1] == 0 or one[0] not in own] -> ]
graders/classwork/sheets.py: formulas in spreadsheets (grading)
    re.sub(FORMULA, r"'\\1", one_line(one)) -> one_line(one)
graders/classwork/sheets.py: a submission that fails, passes (grading)
    return row["state"] == "graded" and not row["failed"] -> return row["state"] == "graded"
rbs/glass/beside.py: tensors, any (graders)
    least=sys.float_info.min) <= TOLERANCE -> least=sys.float_info.min) <= 1e18
graders/isolated/archives.py: links, opened (isolation)
    stat.S_ISREG(os.lstat(one).st_mode) -> stat.S_ISREG(os.stat(one).st_mode)
graders/isolated/archives.py: large files, read (isolation)
    if len(content) > most or -> if
graders/isolated/archives.py: a submission that was replaced, the same (skeleton)
    b"\\0%d\\0" % len(content) + content) -> b"")
graders/isolated/archives.py: a better file, not named (grading)
    if one != own and count > size[top]] -> if False]
graders/isolated/archives.py: the deepest module, taken (grading)
    key=lambda one: (len(one), -> key=lambda one: (-len(one),
graders/isolated/archives.py: copies under other names, not read (grading)
    if name and name != module: -> if False:
graders/isolated/processes.py: files without a bound (cheats)
    and _size(self._path) > MOST_WRITTEN -> and False
graders/worker/main.py: the user of the grader, kept (cheats)
        os.setuid(user) -> pass
graders/isolated/stepComparison.py: first difference, larger ones only (compare)
    if found <= TOLERANCE: -> if found <= 1e9 * TOLERANCE:
graders/isolated/stepComparison.py: a lost velocity, excused always (compare)
    if not all(map(same_numbers, found, theirs)): -> if False:
rbs/glass/trace.py: terms of an event, not compared (compare)
    if wrong := deviations(other, own): -> if wrong := []:
graders/isolated/stepComparison.py: a function that returns nothing (compare)
    if told["result"] is None and -> if False and
graders/worker/calls.py: a tensor that is kept, right (hints)
    mesh.get_rotated_inv_IT() -> mesh
graders/worker/calls.py: numbers for truth, any (grading)
    array[0] not in (0.0, 1.0): -> False:
rbs/program/submittedsteps.py: friction, not passed on (submittedSteps)
    {self._friction: mu} if mu else {} -> {}
rbs/program/submittedsteps.py: gravity, the Earth's (submittedSteps)
    if gravity != EARTH and not self.isFixed: -> if False:
rbs/program/submittedsteps.py: arrays that a student edits, ours (submittedSteps)
    return tuple(np.array(one, dtype=np.float64) for one in arrays) -> return arrays
rbs/program/submittedsteps.py: vertices, as a student left them (submittedSteps)
    return np.array(super().currVertices) -> return super().currVertices
rbs/program/submittedsteps.py: what a student's constructor adds, left out (submittedSteps)
    vars(mesh).update(more, adoptedBy=self) -> mesh.adoptedBy = self
rbs/program/submittedsteps.py: a method with one of our names, taken (submittedSteps)
    if callable(getattr(theirs, name, None)): -> if False:
rbs/glass/beside.py: the release's turned tensor, a mistake (submittedSteps)
    if theirs.submitted.is_turned_back(theirs.meshes): -> if False:
rbs/program/submissions.py: lines of a student's error, outermost first (submittedSteps)
    places.insert(0, f"{Path( -> places.append(f"{Path(
rbs/recordings/recording.py: a link to a missing file, replaced (keeping)
    self.partial = self.target -> self.partial = self.path
rbs/recordings/outputs.py: the folder of a file, that of the end of the run (keeping)
    Path(os.path.realpath(path))  # -> Path(path)  #
rbs/scenes/state.py: inertia that is assigned, not recorded (keeping)
    "inertia": INERTIA -> "inertia": slice(13, 13)
rbs/recordings/recording.py: states of a run that ends, removed (keeping)
    if self.count and self.partial is not None: -> if False:
rbs/recordings/recording.py: changes by hand, made after their step (keeping)
    for bisect in (bisect_left, bisect_right) -> for bisect in (bisect_left, bisect_left)
rbs/recordings/recording.py: another version, not told (recording)
    (self.code != code_digest()) -> False
rbs/recordings/replay.py: a replay after an addition, with the bodies of before (keeping)
    bisect_right(self._steps, step)) -> bisect_right(self._steps, step - 1))
rbs/recordings/replay.py: signs of zeros, not compared (recording)
    isOther = differing_bits(values, frame[name]) -> isOther = np.asarray(values != frame[name])
rbs/window/hand.py: push, the same impulse for every mass (timeline)
    view.picked_mesh.mass * PUSH_SPEED -> PUSH_SPEED
rbs/window/hand.py: drag while paused, the wrong way (timeline)
    way = grab.target - grab.point(mesh) -> way = grab.point(mesh) - grab.target
rbs/window/outputs.py: a file of the same name, written over (timeline)
    while path.exists(): -> while False:
rbs/recordings/outputs.py: a file that fails, goes on (timeline)
    if writer := self.writers.pop(name, None): -> if writer := self.writers.get(name):
"""
FAULTS = [
    Fault(*re.fullmatch(r"(\S+): (.+) \((.+)\)\n {4}(.+) -> (.+)", pair).groups())
    for pair in re.findall(r".+\n {4}.+", FAULTS_IN_TEXT)
]
# The project as it is, with all tests that any fault names.
NONE = Fault("RBSFunctions.py", "none", " ".join(one.tests for one in FAULTS), "", "")


def first_failure(fault):
    """The first of the fault's tests that fails in a copy of the project with the fault, or ""; and
    how many seconds that took.
    """
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        leftOut = shutil.ignore_patterns(".*", "__pycache__", "out", "report")
        copy = shutil.copytree(ROOT, Path(folder, "project"), ignore=leftOut)
        source = (copy / fault.file).read_text(encoding="utf-8")
        (copy / fault.file).write_text(source.replace(fault.text, fault.wrong), encoding="utf-8")
        names = dict.fromkeys(fault.tests.split())
        files = [str(next(copy.glob(f"tests/*/test_{name}.py"))) for name in names]
        options = "-q -x -p no:cacheprovider -m".split()
        command = [sys.executable, "-m", "pytest", *options, "", *files]
        process = subprocess.run(command, cwd=copy, capture_output=True, text=True)
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", process.stdout, re.MULTILINE)
    if (process.returncode != 0) != bool(failed):
        raise RuntimeError(f"pytest ended otherwise than expected:\n{process.stdout[-2000:]}")
    return failed[1] if failed else "", time.monotonic() - begin


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    text = "number of a fault, or the beginning of its file's path (default: all)"
    parser.add_argument("words", metavar="WORD", nargs="*", help=text)
    parser.add_argument("--jobs", metavar="N", type=int, default=1)
    options = parser.parse_args()
    begin, words = time.monotonic(), options.words or [""]
    chosen = [
        (number, fault)
        for number, fault in enumerate(FAULTS, start=1)
        if any(word == str(number) or fault.file.startswith(word) for word in words)
    ]
    chosen += [(0, NONE)] * (not options.words)
    wrong = 0
    with ThreadPoolExecutor(options.jobs) as executor:
        results = executor.map(first_failure, [fault for _, fault in chosen])
        for (number, fault), (failed, seconds) in zip(chosen, results, strict=True):
            wrong += bool(failed) == (fault == NONE)
            told = failed or ("passes" if fault == NONE else "SURVIVED")
            print(f"{number:3} {seconds:4.0f} s  {fault.file}: {fault.what}: {told}", flush=True)
    minutes = (time.monotonic() - begin) / 60
    print(f"{len(chosen) - wrong} of {len(chosen)} as they should be, {minutes:.1f} minutes")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
