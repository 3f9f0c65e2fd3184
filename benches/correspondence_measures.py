"""The measures used by `correspondence.py`, in NumPy and SciPy only, independent of the library's measures.

Members are points at the same directions, X (n, V, 3). The weights (V,) are the vertices' shares of the area, averaged
over members.
"""

import numpy as np
from scipy.spatial import cKDTree


def triangles(vertices, faces):
    return (vertices[faces[:, k]] for k in range(3))


def normals(vertices, faces):
    """Returns the normals of the triangles, with length twice the area."""
    a, b, c = triangles(vertices, faces)
    return np.cross(b - a, c - a)


def shares(vertices, faces):
    area = np.linalg.norm(normals(vertices, faces), axis=1)
    share = np.bincount(faces.ravel(), np.repeat(area, 3), len(vertices))
    return share / share.sum()


def weights(members, faces):
    return np.mean([shares(member, faces) for member in members], axis=0)


def rotation(p, q, weight=None):
    """Returns R and t that minimise the squared distances between p R + t and q."""
    weight = np.full(len(p), 1 / len(p)) if weight is None else weight
    centre_p, centre_q = weight @ p, weight @ q
    u, _, v = np.linalg.svd(((p - centre_p) * weight[:, None]).T @ (q - centre_q))
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v
    return turn, centre_q - centre_p @ turn


def together(members, weight, rounds=5):
    """Aligns members rigidly to their mean."""
    members = members - np.einsum("v,nvc->nc", weight, members)[:, None]
    for _ in range(rounds):
        mean = members.mean(0)
        moves = [rotation(member, mean, weight) for member in members]
        members = np.array([member @ turn + shift for member, (turn, shift) in zip(members, moves)])
    return members


def modes(members, weight):
    """Returns scores, variances and unit modes of members, as rows of sqrt(w) x."""
    rows = (members * np.sqrt(weight)[None, :, None]).reshape(len(members), -1)
    u, s, v = np.linalg.svd(rows - rows.mean(0), full_matrices=False)
    return rows, u * s, s**2 / (len(rows) - 1), v


def generalisation(members, weight, count):
    rows, found = modes(members, weight)[0], []
    for i, row in enumerate(rows):
        others = np.delete(rows, i, 0)
        rest = row - others.mean(0)
        basis = np.linalg.svd(others - others.mean(0), full_matrices=False)[2][:count]
        found.append(np.linalg.norm(rest - basis.T @ (basis @ rest)))
    return float(np.mean(found))


def specificity(members, weight, count, samples=1000):
    rows, _, variances, basis = modes(members, weight)
    z = np.random.default_rng(0).normal(size=(samples, count)) * np.sqrt(variances[:count])
    along = (rows - rows.mean(0)) @ basis[:count].T
    rest = ((rows - rows.mean(0)) ** 2).sum(1) - (along**2).sum(1)
    square = (z**2).sum(1)[:, None] - 2 * z @ along.T + (along**2).sum(1) + rest
    return float(np.sqrt(np.maximum(square, 0)).min(1).mean())


def shares_of_modes(members, weight):
    variances = modes(members, weight)[2]
    return variances / variances.sum()


def determination(members, weight, truth, count):
    """Returns the smallest R^2 of the columns of truth, regressed on the scores of the first modes."""
    scores = modes(members, weight)[1][:, :count]
    design = np.c_[np.ones(len(scores)), scores]
    truth = np.asarray(truth, float).reshape(len(scores), -1)
    rest = truth - design @ np.linalg.lstsq(design, truth, rcond=None)[0]
    return float((1 - (rest**2).sum(0) / ((truth - truth.mean(0)) ** 2).sum(0)).min())


def closest(vertices, faces, points, k=24):
    """Returns the nearest points of a mesh, their triangles and distances, among the k triangles with the nearest centres."""
    near = cKDTree(vertices[faces].mean(1)).query(points, k=min(k, len(faces)))[1]
    best = np.full(len(points), np.inf)
    at, which = np.array(points, float), near[:, 0].copy()
    for column in range(near.shape[1]):
        a, b, c = triangles(vertices, faces[near[:, column]])
        found = on_triangles(points, a, b, c)
        distance = np.linalg.norm(found - points, axis=1)
        nearer = distance < best
        best[nearer], at[nearer], which[nearer] = distance[nearer], found[nearer], near[nearer, column]
    return at, which, best


def on_triangles(p, a, b, c):
    """Returns the nearest point of each triangle to each point: inside it, or else on one of its edges."""
    e, g, h = b - a, c - a, p - a
    ee, eg, gg = (e * e).sum(1), (e * g).sum(1), (g * g).sum(1)
    x, y = (h * e).sum(1), (h * g).sum(1)
    area = np.maximum(ee * gg - eg * eg, 1e-30)
    s, t = (gg * x - eg * y) / area, (ee * y - eg * x) / area
    found = a + s[:, None] * e + t[:, None] * g
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    best = np.where(inside, 0.0, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        along = np.clip(((p - start) * edge).sum(1) / np.maximum((edge**2).sum(1), 1e-30), 0, 1)
        point = start + along[:, None] * edge
        distance = np.linalg.norm(point - p, axis=1)
        nearer = ~inside & (distance < best)
        best[nearer], found[nearer] = distance[nearer], point[nearer]
    return found


def landmark_errors(carry, surfaces, landmarks):
    """Returns errors of all ordered pairs, (n, n - 1, p): the distance of a carried landmark from the target's own
    landmark, on the target's surface."""
    own = [closest(*surface, marks)[0] for surface, marks in zip(surfaces, landmarks)]
    found = []
    for source, marks in enumerate(own):
        targets = [target for target in range(len(own)) if target != source]
        found.append([np.linalg.norm(carry(marks, source, target) - own[target], axis=1) for target in targets])
    return np.array(found)


def turned(vertices, faces, surface):
    """Returns the number of triangles that face against all nearest triangles of the surface; a point nearest to an
    edge has several."""
    own, theirs = normals(vertices, faces), normals(*surface)
    centres, corners = vertices[faces].mean(1), surface[0][surface[1]]
    least = closest(*surface, centres)[2]
    near = cKDTree(corners.mean(1)).query(centres, k=min(24, len(corners)))[1]
    along = np.full(len(own), -np.inf)
    for column in near.T:
        distance = np.linalg.norm(on_triangles(centres, *(corners[column, k] for k in range(3))) - centres, axis=1)
        nearest = distance <= least + 1e-9 * (1 + least)
        along[nearest] = np.maximum(along, (own * theirs[column]).sum(1))[nearest]
    return int((along < 0).sum())
