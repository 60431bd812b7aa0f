"""A student's quaternions: rows (w, x, y, z), written from the text of the coursework."""

import numpy as np


def QMult(q1, q2):
    w1, v1 = q1[:, [0]], q1[:, 1:]
    w2, v2 = q2[:, [0]], q2[:, 1:]
    w = w1 * w2 - np.sum(v1 * v2, axis=1, keepdims=True)
    v = w1 * v2 + w2 * v1 + np.cross(v1, v2)
    return np.concatenate((w, v), axis=1)


def QConj(q):
    return q * np.array([[1.0, -1.0, -1.0, -1.0]])


def QInv(q):
    return QConj(q) / np.sum(q * q, axis=1, keepdims=True)


def QRotate(q, v):
    pure = np.concatenate((np.zeros((v.shape[0], 1)), v), axis=1)
    return QMult(QMult(q, pure), QInv(q))[:, 1:]


def QExp(q):
    length = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    safe = np.where(length > 0.0, length, 1.0)
    return np.exp(q[:, [0]]) * np.concatenate(
        (np.cos(length), np.sin(length) * q[:, 1:] / safe), axis=1
    )


def Q2RotMatrix(q):
    return QRotate(q, np.eye(3)).T
