"""The skeleton as a student has it, a right solution on top of it, and variants of that.

`submissions/skeleton` has the traits of the coursework's released skeleton. The solution fills its
five stubs with the formulas of the coursework's text, without guards that no released datum needs.
"""
# ruff: noqa: E501

from pathlib import Path

SKELETON = Path(__file__).resolve().parent / "submissions" / "skeleton"
TEXT = (SKELETON / "RBSFunctions.py").read_text(encoding="utf-8")
QUATERNION = (SKELETON / "Quaternion.py").read_text(encoding="utf-8")

INTEGRATED = """        if not self.isFixed:
            self.linVelocity = self.linVelocity + timeStep * np.array([[0.0, -9.8, 0.0]])
            self.position = self.position + timeStep * self.linVelocity
            half = np.hstack([[[0.0]], 0.5 * timeStep * self.angVelocity.reshape(1, 3)])
            self.orientation = QMult(QExp(half).reshape(1, 4), self.orientation)
"""
TURNED = """        R = Q2RotMatrix(self.orientation)
        return R @ self.invIT @ R.T
"""
WEIGHTED = """    w1 = m1.invMass / (m1.invMass + m2.invMass)
    w2 = m2.invMass / (m1.invMass + m2.invMass)
    contactNormal = np.reshape(contactNormal, (1, 3))
    m1.position = m1.position - w1 * depth * contactNormal
    m2.position = m2.position + w2 * depth * contactNormal
    contact = np.reshape(penPoint, (1, 3)) + w2 * depth * contactNormal
"""
PUSHED = """    r1, r2 = contact - m1.position, contact - m2.position
    invI1, invI2 = m1.get_rotated_inv_IT(), m2.get_rotated_inv_IT()
    c1, c2 = np.cross(r1, contactNormal), np.cross(r2, contactNormal)
    closing = (m1.linVelocity + np.cross(m1.angVelocity, r1)
               - m2.linVelocity - np.cross(m2.angVelocity, r2)) @ contactNormal.T
    K = m1.invMass + m2.invMass + c1 @ invI1 @ c1.T + c2 @ invI2 @ c2.T
    j = (1 + CRCoeff) * closing / K
    m1.linVelocity = m1.linVelocity - j * m1.invMass * contactNormal
    m2.linVelocity = m2.linVelocity + j * m2.invMass * contactNormal
    m1.angVelocity = m1.angVelocity - j * (invI1 @ c1.T).T
    m2.angVelocity = m2.angVelocity + j * (invI2 @ c2.T).T
"""
PLACED = """    p1, p2 = np.reshape(currConstPoints[0], (1, 3)), np.reshape(currConstPoints[1], (1, 3))
    length = np.linalg.norm(p1 - p2)
    C = length - refValue
    if (upper and C <= tolerance) or (not upper and C >= -tolerance):
        return True, currPositions
    n = (p1 - p2) / length
    w1 = invMasses[0] / (invMasses[0] + invMasses[1])
    w2 = invMasses[1] / (invMasses[0] + invMasses[1])
    return False, (currPositions[0] - w1 * C * n, currPositions[1] + w2 * C * n)
"""
STEADIED = """    p1, p2 = np.reshape(currConstPoints[0], (1, 3)), np.reshape(currConstPoints[1], (1, 3))
    n = (p1 - p2) / np.linalg.norm(p1 - p2)
    c1, c2 = np.cross(p1 - currPositions[0], n), np.cross(p2 - currPositions[1], n)
    J = np.hstack([n, c1, -n, -c2])
    v = np.hstack([currLinVelocities[0], currAngVelocities[0],
                   currLinVelocities[1], currAngVelocities[1]]).reshape(12, 1)
    if abs(J @ v) <= tolerance:
        return True, currLinVelocities, currAngVelocities
    invM = scipy.linalg.block_diag(invMasses[0] * np.eye(3), invInertiaTensors[0],
                                   invMasses[1] * np.eye(3), invInertiaTensors[1])
    lam = np.linalg.inv(J @ invM @ J.T) @ (J @ v)
    v = (v - invM @ J.T @ lam).reshape(4, 1, 3)
    return False, (v[0], v[2]), (v[1], v[3])
"""
STUBS = {
    "    # TODO: the velocity constraint\n    return True, currLinVelocities, currAngVelocities\n": (
        STEADIED
    ),
    "    # TODO: the position constraint\n    return True, currPositions\n": PLACED,
    "    # TODO: the interpenetration\n": WEIGHTED,
    "    # TODO: the velocities\n": PUSHED,
    "        # TODO: the tensor in world axes\n        return np.identity(3)\n": TURNED,
    "        # TODO: velocity, position and orientation of a body that is not fixed\n": INTEGRATED,
}


def changed(text, *edits):
    """A text after edits (old, new), each of which occurs once."""
    for old, new in edits:
        assert text.count(old) == 1, f"{text.count(old)} times: {old}"
        text = text.replace(old, new)
    return text


SOLUTION = changed(TEXT, *STUBS.items())
# The guard that the literal weights lack, and the reshape that the supplied QExp asks for.
GUARD = (WEIGHTED, "    if m1.invMass + m2.invMass == 0.0:\n        return\n" + WEIGHTED)
UNSHAPED = ("QExp(half).reshape(1, 4)", "QExp(half)")
ALONE = {"RBSFunctions.py": SOLUTION}
BOTH = ALONE | {"Quaternion.py": QUATERNION}
LIBRARY = "vec3.py support.py mpr.py ccd.py isCollide.py".split()
WHOLE = {f"code/{name}": text for name, text in BOTH.items()}
WHOLE |= {f"code/{name}": "import cppyy\ncppyy.cppdef('never compiled')\n" for name in LIBRARY}
WHOLE |= {
    "code/InitializeCCD.py": "def initialize_libccd():\n    for name in "
    f"{LIBRARY!r}:\n        exec(open(name).read())\n",
    "code/RBSLoadVis.py": "from RBSFunctions import Mesh\n",
    "code/RigidBodySimulation.py": "import polyscope\npolyscope.init()\npolyscope.show()\n",
    "data/singletet-scene.txt": "0\n",
    "report.pdf": "%PDF-1.4\n",
}


def written(folder, files):
    """Writes files into a new folder, a dict from path to text or bytes; returns the folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def variant(*edits, **files):
    """The solution's two files after edits of RBSFunctions.py."""
    return BOTH | {"RBSFunctions.py": changed(SOLUTION, *edits)} | files


# Mistakes in the solution, and right ones at the end: a list of edits each.
MISTAKES = {
    "no-reshape": [UNSHAPED],
    "flag-always-true": [
        ("    return False, (currPositions[0]", "    return True, (currPositions[0]")
    ],
    "tolerance-times-refvalue": [
        ("    C = length - refValue\n", "    C = length - refValue\n    tolerance *= refValue\n")
    ],
    "last-block-sign": [("J = np.hstack([n, c1, -n, -c2])", "J = np.hstack([n, c1, -n, c2])")],
    "spin-2-sign": [("m2.angVelocity + j * (invI2", "m2.angVelocity - j * (invI2")],
    "lambda-without-mass": [("np.linalg.inv(J @ invM @ J.T)", "np.linalg.inv(J @ J.T)")],
    "blocks-of-j": [("J = np.hstack([n, c1, -n, -c2])", "J = np.hstack([n, -n, c1, -c2])")],
    "blocks-of-v": [
        ("currAngVelocities[0],\n                   currLin", "currLinVelocities[1],\n   currAng"),
        ("Velocities[1], currAngVelocities[1]])", "Velocities[0], currAngVelocities[1]])"),
        ("(v[0], v[2]), (v[1], v[3])", "(v[0], v[1]), (v[2], v[3])"),
    ],
    "one-rotational-term": [(" + c2 @ invI2 @ c2.T\n", "\n")],
    "tensor-times-r": [("return R @ self.invIT @ R.T", "return R @ self.invIT")],
    "scalar-last": [
        (
            "R = Q2RotMatrix(self.orientation)",
            "from scipy.spatial.transform import Rotation\n"
            "        R = Rotation.from_quat(self.orientation[0]).as_matrix()",
        )
    ],
    "friction": [
        ("contactNormal, penPoint, CRCoeff):", "contactNormal, penPoint, CRCoeff, mu=0.3):"),
        (
            PUSHED,
            PUSHED + "    slip = m1.linVelocity - m2.linVelocity\n"
            "    slip = slip - (slip @ contactNormal.T) * contactNormal\n"
            "    push = mu * abs(j) * slip / max(np.linalg.norm(slip), 1e-9)\n"
            "    m1.linVelocity = m1.linVelocity - m1.invMass * push\n"
            "    m2.linVelocity = m2.linVelocity + m2.invMass * push\n",
        ),
    ],
    "lists": [("(v[0], v[2]), (v[1], v[3])", "(v[0].tolist(), v[2].tolist()), (v[1], v[3])")],
    "guarded": [GUARD],
    "NumPy's zeros": [("        self.invMass = 0.0\n", "        self.invMass = np.zeros(1)\n")],
}
