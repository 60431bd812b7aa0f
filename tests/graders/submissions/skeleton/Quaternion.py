"""Quaternions as the coursework supplies them: rows (w, x, y, z). `QExp` takes one row only."""

import numpy as np


def QMult(q1, q2):
    scalar = q1[:, 0:1] * q2[:, 0:1] - np.sum(q1[:, 1:4] * q2[:, 1:4], axis=1, keepdims=True)
    vector = q1[:, 0:1] * q2[:, 1:4] + q2[:, 0:1] * q1[:, 1:4]
    return np.hstack([scalar, vector + np.cross(q1[:, 1:4], q2[:, 1:4])])


def QConj(q):
    return np.hstack([q[:, 0:1], -q[:, 1:4]])


def QInv(q):
    return QConj(q) / np.sum(q**2, axis=1, keepdims=True)


def QRotate(q, v):
    return QMult(QMult(q, np.hstack([np.zeros((len(v), 1)), v])), QInv(q))[:, 1:4]


def QExp(q):
    norm = np.linalg.norm(q[:, 1:4], axis=1)
    if norm < 1e-15:  # ambiguous for more than one row
        return np.exp(q[0, 0]) * np.array([1.0, 0.0, 0.0, 0.0])
    return np.exp(q[:, 0:1]) * np.hstack([np.cos(norm)[:, None], np.sin(norm) / norm * q[:, 1:4]])


def Q2RotMatrix(q):
    w, x, y, z = q[0]
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])
