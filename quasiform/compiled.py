"""Loops over stencils and points, compiled with numba (extra `fast`).

Each function stands for a few lines of numpy where it is called, and returns the same to
round-off. They are compiled at their first call, once for each kind of machine, and kept on disk.
Arrays are C-contiguous and of floats; `rows` of points, `near`, `dofs`, `slots` and `takers` are of
whole numbers, `acts` of truth values.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

# in the place of arguments that are not given: matrices, values and slots
NONE = np.empty((0, 0, 0)), np.empty(0), np.empty((0, 0), np.int32)


def _compile(function: Any) -> Any:
    """Compile without a cache where no folder for one can be written to."""
    try:
        return numba.njit(cache=True, fastmath={"contract"})(function)
    except RuntimeError:  # numba: "no locator available"
        return numba.njit(fastmath={"contract"})(function)


# a part of the function that calls it: sizes that are constant there unroll its loops
_inline = numba.njit(inline="always")


@_compile
def same(a, b):
    """Whether two arrays (n,) are equal."""
    if len(a) != len(b):
        return False
    for i in range(len(a)):
        if a[i] != b[i]:
            return False
    return True


# Sums over stencils


@_compile
def add_forces(out, dofs, forces):
    """Add forces (m, k), in any order in memory, to out[dofs]."""
    for e in range(dofs.shape[0]):
        for i in range(dofs.shape[1]):
            out[dofs[e, i]] += forces[e, i]


@_inline
def _add(values, slot, value):
    """Add to the values at a slot, twice at ~slot: where two unknowns of a stencil are one."""
    if slot >= 0:
        values[slot] += value
    else:
        values[~slot] += 2.0 * value


@_inline
def _put(out, values, slots, e, K):
    """Put the stiffness of stencil e, the upper half of K (k, k), where it is wanted.

    It is set in `out` (m, k, k) if that has rows; else it is added to the values at slots[e].
    """
    k, p = len(K), 0
    if len(out):
        for i in range(k):
            for j in range(i, k):
                out[e, i, j] = out[e, j, i] = K[i, j]
    else:
        for i in range(k):
            for j in range(i, k):
                _add(values, slots[e, p], K[i, j])
                p += 1


@_compile
def add_stiffness(values, rows, slots, H):
    """Add the upper triangles of H (m, k, k) to the values at slots[rows]."""
    none = np.empty((0, 0, 0))
    for e in range(len(rows)):
        _put(none, values, slots, rows[e], H[e])


@_compile
def add_point_forces(out, rows, dofs, shares, forces):
    """Add forces (m, 3) on points `rows` to their nodes and to the height of the tool, the last."""
    last = dofs.shape[1] - 1
    for e in range(len(rows)):
        row = rows[e]
        for i in range(last):
            out[dofs[row, i]] += shares[row, i] * forces[e, i % 3]
        out[dofs[row, last]] += shares[row, last] * forces[e, 2]


@_compile
def gather(K, acts, rows, of_rows):
    """Add stiffnesses (r, 3, 3) of points `rows` to those of all points, K (m, 3, 3)."""
    for e in range(len(rows)):
        acts[rows[e]] = True
        for a in range(3):
            for b in range(3):
                K[rows[e], a, b] += of_rows[e, a, b]


@_inline
def _add_points(values, acts, slots, shares, K, nodes):
    for e in range(len(acts)):
        if not acts[e]:
            continue
        tool, p = shares[e, 3 * nodes], 0
        for i in range(nodes):
            for a in range(3):
                weight = shares[e, 3 * i + a]
                if weight == 0.0:  # no neighbour there
                    p += 3 * (nodes - i) + 1 - a
                    continue
                for j in range(i, nodes):
                    for b in range(a if j == i else 0, 3):
                        share = weight * shares[e, 3 * j + b]
                        _add(values, slots[e, p], share * K[e, a, b])
                        p += 1
                _add(values, slots[e, p], weight * tool * K[e, a, 2])
                p += 1
        _add(values, slots[e, p], tool * tool * K[e, 2, 2])


@_compile
def add_point_stiffness(values, acts, slots, shares, K):
    """Add stiffnesses K (m, 3, 3) of points that act (m,), as seen by their nodes and the tool."""
    if shares.shape[1] == 16:
        _add_points(values, acts, slots, shares, K, 5)
    else:
        _add_points(values, acts, slots, shares, K, (shares.shape[1] - 1) // 3)


# Membrane


@_compile
def three_stages(I, I0, C_ini, S_ini, C_mid, dS_mid, C_lo, I_lo):
    """Energy, stress and stiffness (n,) of `ThreeStageLaw` at I; with S_ini = inf it is linear."""
    W, S, C = np.empty(len(I)), np.empty(len(I)), np.empty(len(I))
    It, c = S_ini / C_ini, C_ini / dS_mid
    for e in range(len(I)):
        x = abs(I[e] - I0)
        if x < It:
            W[e], S[e], C[e] = 0.5 * C_ini * x**2, C_ini * (I[e] - I0), C_ini
            continue
        y, z = x - It, max(x - I_lo, 0.0)
        E = -np.expm1(-c * y)  # 1 - exp(-c y)
        W[e] = 0.5 * C_ini * It**2 + S_ini * y + 0.5 * C_mid * y**2 + dS_mid * (y - E / c)
        W[e] += C_lo * z * z**2 / 3.0 - C_mid * (E / c**2 - y * (1.0 - E) / c)
        stress = S_ini + (C_mid * y + dS_mid) * E + C_lo * z**2
        S[e] = stress if I[e] > I0 else -stress
        C[e] = C_mid * E + (C_mid * y + dS_mid) * c * (1.0 - E) + 2.0 * C_lo * z
    return W, S, C


@_compile
def fibre_vectors(g, dofs, x):
    """(2, dim, n) vectors f_p = Σ_i g_pi x_i from g (2, k, n) and the numbers (n, k dim) in x."""
    _, k, n = g.shape
    dim = dofs.shape[1] // k
    f = np.zeros((2, dim, n))
    for e in range(n):
        for i in range(k):
            for c in range(dim):
                place = x[dofs[e, dim * i + c]]
                f[0, c, e] += g[0, i, e] * place
                f[1, c, e] += g[1, i, e] * place
    return f


@_compile
def invariants(f):
    """I4, I6, I8 (n,) of fibre vectors (2, dim, n)."""
    n = f.shape[2]
    I4, I6, I8 = np.zeros(n), np.zeros(n), np.zeros(n)
    for c in range(f.shape[1]):
        for e in range(n):
            I4[e] += f[0, c, e] * f[0, c, e]
            I6[e] += f[0, c, e] * f[1, c, e]
            I8[e] += f[1, c, e] * f[1, c, e]
    return I4, I6, I8


@_compile
def turned_over(f, after):
    """Whether a triangle has turned over between two states with fibre vectors (2, dim, n)."""
    for e in range(f.shape[2]):
        turn = 0.0
        for a in range(3 if f.shape[1] == 3 else 1):
            i, j = ((a + 1) % 3, (a + 2) % 3) if f.shape[1] == 3 else (0, 1)
            before = f[0, i, e] * f[1, j, e] - f[0, j, e] * f[1, i, e]
            turn += before * (after[0, i, e] * after[1, j, e] - after[0, j, e] * after[1, i, e])
        if turn <= 0.0:
            return True
    return False


@_compile
def nodal_forces(g, S, f):
    """(n, k dim) forces Σ_pq g_pi S_pq f_q from stresses (2, 2, n) and fibre vectors."""
    _, k, n = g.shape
    dim = f.shape[1]
    forces = np.empty((n, k * dim))
    for e in range(n):
        for c in range(dim):
            warp = S[0, 0, e] * f[0, c, e] + S[0, 1, e] * f[1, c, e]
            weft = S[1, 0, e] * f[0, c, e] + S[1, 1, e] * f[1, c, e]
            for i in range(k):
                forces[e, dim * i + c] = g[0, i, e] * warp + g[1, i, e] * weft
    return forces


@_inline
def _membrane(g, f, S, W, out, values, slots, k, dim):
    Kg, H = np.empty((2, dim, dim)), np.empty((k * dim, k * dim))
    for e in range(f.shape[2]):
        W4, W6, W8 = 4.0 * W[0, e], W[1, e], 4.0 * W[2, e]
        warp, both, weft = S[0, 0, e], S[0, 1, e], S[1, 1, e]
        for j in range(k):
            g0, g1 = g[0, j, e], g[1, j, e]
            for c in range(dim):
                a, b = f[0, c, e], f[1, c, e]
                # second derivatives by one fibre vector and by node j, in terms of both vectors
                aa, ab = W4 * a * g0 + W6 * b * g1, W6 * b * g0
                ba, bb = W6 * a * g1, W6 * a * g0 + W8 * b * g1
                for d in range(dim):
                    Kg[0, c, d] = aa * f[0, d, e] + ab * f[1, d, e]
                    Kg[1, c, d] = ba * f[0, d, e] + bb * f[1, d, e]
                Kg[0, c, c] += warp * g0 + both * g1
                Kg[1, c, c] += both * g0 + weft * g1
            for i in range(j + 1):
                h0, h1 = g[0, i, e], g[1, i, e]
                for c in range(dim):
                    for d in range(dim):
                        H[dim * i + c, dim * j + d] = h0 * Kg[0, c, d] + h1 * Kg[1, c, d]
        _put(out, values, slots, e, H)


@_compile
def membrane_stiffness(g, f, S, W, out, values, slots):
    """Stiffnesses of all stencils of the membrane, set in `out` or added to values; see `_put`.

    From g (2, k, n), fibre vectors f (2, dim, n), stress S (2, 2, n) and W = W4'', W6'', W8''
    (3, n).
    """
    k, dim = g.shape[1], f.shape[1]
    if k == 3 and dim == 3:
        _membrane(g, f, S, W, out, values, slots, 3, 3)
    elif k == 3 and dim == 2:
        _membrane(g, f, S, W, out, values, slots, 3, 2)
    elif k == 6 and dim == 3:
        _membrane(g, f, S, W, out, values, slots, 6, 3)
    elif k == 6 and dim == 2:
        _membrane(g, f, S, W, out, values, slots, 6, 2)
    else:
        _membrane(g, f, S, W, out, values, slots, k, dim)


# Bending


@_inline
def _combine(y, rows, constant, dofs, x, k, dim):
    place = np.empty(k * dim)
    for e in range(len(y)):
        for i in range(k * dim):
            place[i] = x[dofs[e, i]]
        for r in range(y.shape[1]):
            for c in range(dim):
                total = constant[e, r, c]
                for i in range(k):
                    total += rows[e, r, i, c] * place[dim * i + c]
                y[e, r, c] = total


@_compile
def combine(rows, constant, dofs, x, count):
    """(m, count, dim) first combinations of the nodes (m, k dim) by rows (m, 4, k, dim)."""
    m, _, k, dim = rows.shape
    y = np.empty((m, count, dim))
    if k == 5 and dim == 3:
        _combine(y, rows, constant, dofs, x, 5, 3)
    else:
        _combine(y, rows, constant, dofs, x, k, dim)
    return y


@_inline
def _spread(nodal, rows, forces, k, dim):
    for e in range(len(nodal)):
        for i in range(k):
            for c in range(dim):
                total = 0.0
                for r in range(forces.shape[1]):
                    total += rows[e, r, i, c] * forces[e, r, c]
                nodal[e, dim * i + c] = total


@_compile
def spread(rows, forces):
    """(m, k dim) nodal forces from forces (m, count, dim) on these combinations."""
    m, _, k, dim = rows.shape
    nodal = np.empty((m, k * dim))
    if k == 5 and dim == 3:
        _spread(nodal, rows, forces, 5, 3)
    else:
        _spread(nodal, rows, forces, k, dim)
    return nodal


@_compile
def bending_curvature(y):
    """Curvatures (m, 2), normals (m, 3) and |u x v| (m,) from k_warp, k_weft, u, v (m, 4, 3)."""
    m = len(y)
    kappa, normal, length = np.empty((m, 2)), np.empty((m, 3)), np.empty(m)
    for e in range(m):
        u, v = y[e, 2], y[e, 3]
        n0 = u[1] * v[2] - u[2] * v[1]
        n1 = u[2] * v[0] - u[0] * v[2]
        n2 = u[0] * v[1] - u[1] * v[0]
        size = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        n0, n1, n2 = n0 / size, n1 / size, n2 / size
        normal[e, 0], normal[e, 1], normal[e, 2], length[e] = n0, n1, n2, size
        for f in range(2):
            kappa[e, f] = y[e, f, 0] * n0 + y[e, f, 1] * n1 + y[e, f, 2] * n2
    return kappa, normal, length


@_compile
def bending_energy(y, kappa, B, r):
    """(m,) energies with the stiffnesses B (m, 2) and the in-plane share r."""
    energy = np.zeros(len(y))
    for e in range(len(y)):
        for f in range(2):
            square = y[e, f, 0] ** 2 + y[e, f, 1] ** 2 + y[e, f, 2] ** 2
            energy[e] += 0.5 * B[e, f] * ((1.0 - r) * kappa[e, f] ** 2 + r * square)
    return energy


@_inline
def _cross(out, a, b):
    """Set a x b."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@_inline
def _slopes(y, f, kappa, n, length, q, d):
    """Set q = (k - κ n)/|u x v| and the derivatives d (12,) of the curvature of family f."""
    per = 1.0 / length
    for c in range(3):
        q[c] = (y[f, c] - kappa * n[c]) * per
        d[3 * f + c], d[3 * (1 - f) + c] = n[c], 0.0
    _cross(d[6:9], y[3], q)
    _cross(d[9:12], q, y[2])


@_compile
def bending_forces(y, kappa, normal, length, B, r):
    """(m, 4, 3) derivatives of the energy by k_warp, k_weft, u and v."""
    forces = np.zeros((len(y), 12))
    q, d = np.empty(3), np.empty(12)
    for e in range(len(y)):
        for f in range(2):
            _slopes(y[e], f, kappa[e, f], normal[e], length[e], q, d)
            force = (1.0 - r) * B[e, f] * kappa[e, f]
            for s in range(12):
                forces[e, s] += force * d[s]
            for c in range(3):
                forces[e, 3 * f + c] += r * B[e, f] * y[e, f, c]
    return forces.reshape(-1, 4, 3)


@_inline
def _curved(y, n, length, w, total, Q, H):
    """Add what the second derivative of κ contributes to H (12, 12): w = B κ, total = Σ w κ."""
    P, PM, CM = np.empty((3, 3)), np.empty((3, 6)), np.empty(6)
    C, u, v, per = np.empty((3, 3)), y[2], y[3], 1.0 / length
    # with m = u x v: P = (1 - n n')/|m|; P and C times the derivative of m by u and v
    for a in range(3):
        for b in range(3):
            P[a, b] = ((1.0 if a == b else 0.0) - n[a] * n[b]) * per
            C[a, b] = -(n[a] * Q[b] + Q[a] * n[b] + total * P[a, b]) * per
        _cross(PM[a, :3], v, P[a])
        _cross(PM[a, 3:], P[a], u)
        for f in range(2):
            for b in range(6):
                H[3 * f + a, 6 + b] += w[f] * PM[a, b]
                H[6 + b, 3 * f + a] += w[f] * PM[a, b]
    for a in range(3):
        _cross(PM[a, :3], v, C[a])
        _cross(PM[a, 3:], C[a], u)
    for b in range(6):
        _cross(CM[:3], v, PM[:, b])
        _cross(CM[3:], PM[:, b], u)
        for a in range(6):
            H[6 + a, 6 + b] += CM[a]
    for a in range(3):
        c, g = (a + 1) % 3, (a + 2) % 3
        # minus [Q]x in the block of u and v, and its transpose
        H[6 + c, 9 + a] -= Q[g]
        H[6 + g, 9 + a] += Q[c]
        H[9 + a, 6 + c] -= Q[g]
        H[9 + a, 6 + g] += Q[c]


@_inline
def _project(out, H, R, takers, k, width):
    """Set out (3 k, width) = R' H with rows R (4, k, 3), which only the `takers` of a node take."""
    for i in range(k):
        for b in range(3):
            if takers[i, 0] < 0:
                w, x, y, z = R[0, i, b], R[1, i, b], R[2, i, b], R[3, i, b]
                for a in range(width):
                    warp = w * H[b, a] + y * H[6 + b, a]
                    out[3 * i + b, a] = warp + x * H[3 + b, a] + z * H[9 + b, a]
            else:
                s, t = takers[i, 0], takers[i, 1]
                w, x = R[s, i, b], R[t, i, b]
                for a in range(width):
                    out[3 * i + b, a] = w * H[3 * s + b, a] + x * H[3 * t + b, a]


@_inline
def _bending(y, kappa, normal, length, B, r, convex, rows, takers, out, values, slots, k):
    d, q, Q, w, H = np.empty((2, 12)), np.empty(3), np.empty(3), np.empty(2), np.empty((12, 12))
    HR, RH, K = np.empty((3 * k, 12)), np.empty((12, 3 * k)), np.empty((3 * k, 3 * k))
    for e in range(len(y)):
        w0, w1, total = (1.0 - r) * B[e, 0], (1.0 - r) * B[e, 1], 0.0
        Q[0], Q[1], Q[2] = 0.0, 0.0, 0.0
        for f in range(2):
            _slopes(y[e], f, kappa[e, f], normal[e], length[e], q, d[f])
            w[f] = (1.0 - r) * B[e, f] * kappa[e, f]
            total += w[f] * kappa[e, f]
            for c in range(3):
                Q[c] += w[f] * q[c]
        for a in range(12):
            for b in range(12):
                H[a, b] = w0 * d[0, a] * d[0, b] + w1 * d[1, a] * d[1, b]
        for f in range(2):
            for c in range(3):
                H[3 * f + c, 3 * f + c] += r * B[e, f]
        if not convex:
            _curved(y[e], normal[e], length[e], w, total, Q, H)
        # R' H R with R = `rows`
        _project(HR, H, rows[e], takers, k, 12)
        for i in range(3 * k):
            for a in range(12):
                RH[a, i] = HR[i, a]
        _project(K, RH, rows[e], takers, k, 3 * k)
        _put(out, values, slots, e, K)


@_compile
def bending_stiffness(y, kappa, normal, length, B, r, convex, rows, takers, out, values, slots):
    """Stiffnesses of all stencils of bending, set in `out` or added to values; see `_put`.

    `takers` (k, 2) are the two of the four rows that take a node, or -1 if all do.
    """
    k = rows.shape[2]
    if k == 5:
        _bending(y, kappa, normal, length, B, r, convex, rows, takers, out, values, slots, 5)
    else:
        _bending(y, kappa, normal, length, B, r, convex, rows, takers, out, values, slots, k)


# Contact and friction


@_compile
def places(dofs, shares, x, x0, y0):
    """(m, 3) places of the points less the tool's place and height, the last of the shares."""
    m, last = len(shares), shares.shape[1] - 1
    arm = np.empty((m, 3))
    for e in range(m):
        arm[e, 0], arm[e, 1], arm[e, 2] = -x0, -y0, shares[e, last] * x[dofs[e, last]]
        for i in range(last):
            arm[e, i % 3] += shares[e, i] * x[dofs[e, i]]
    return arm


@_compile
def may_touch(y, centre, clear, steepest):
    """Numbers of the points (m, 3) that have left the balls (m,) in which they touch nothing."""
    rows, count = np.empty(len(y), dtype=np.int64), 0
    for e in range(len(y)):
        square = 0.0
        for c in range(3):
            square += (y[e, c] - centre[e, c]) ** 2
        if not (clear[e] >= 0.0 and steepest**2 * square < clear[e] ** 2):
            rows[count] = e
            count += 1
    return rows[:count].copy()


@_compile
def touching(near, d, n, bend, y, reach, area, k, blend, far, centre, clear):
    """`Acting` from the distances of the points `near`; updates where they are clear."""
    count = 0
    for e in range(len(near)):
        i = near[e]
        clear[i] = d[e] - (far if d[e] >= far else reach[i])
        for c in range(3):
            centre[i, c] = y[i, c]
        count += clear[i] < 0.0
    rows, energy, force = np.empty(count, np.int64), np.empty(count), np.empty((count, 3))
    K, curved = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    t = 0
    for e in range(len(near)):
        i = near[e]
        p = -clear[i]
        if p > 0.0:
            if p < blend:
                value, first, second = p * p**2 / (6 * blend), p**2 / (2 * blend), p / blend
            else:
                value = p**2 / 2 - blend * p / 2 + blend**2 / 6
                first, second = p - blend / 2, 1.0
            rows[t], energy[t], push = i, area[i] * k * value, area[i] * k * first
            for a in range(3):
                force[t, a] = -push * n[e, a]
                for b in range(3):
                    K[t, a, b] = area[i] * k * second * n[e, a] * n[e, b]
                    curved[t, a, b] = push * bend[e, a, b]
            t += 1
    return rows, energy, force, K, curved


@_compile
def friction(rows, points, anchor, normal, limit, stick):
    """Energies (m,), forces (m, 3) and stiffnesses (m, 3, 3) at points `rows` in a tool's frame."""
    m = len(rows)
    energy, force, K = np.empty(m), np.empty((m, 3)), np.empty((m, 3, 3))
    s, n = np.empty(3), np.empty(3)
    for e in range(m):
        i, along = rows[e], 0.0
        for c in range(3):
            s[c], n[c] = points[i, c] - anchor[i, c], normal[i, c]
            if np.isnan(s[c]):
                s[c] = 0.0
            along += s[c] * n[c]
        for c in range(3):
            s[c] -= along * n[c]
        length = np.sqrt(s[0] ** 2 + s[1] ** 2 + s[2] ** 2)
        reach = min(length, limit[i] / stick[i])
        energy[e] = 0.5 * stick[i] * reach**2 + limit[i] * (length - reach)
        slope = limit[i] / max(length, 1e-300)
        slips = stick[i] * length > (1 - 1e-6) * limit[i]
        stiffness = slope if slips else (stick[i] if limit[i] > 0.0 else 0.0)
        for c in range(3):
            force[e, c] = s[c] * min(stick[i], slope)
            for d in range(3):
                across = (1.0 if c == d else 0.0) - n[c] * n[d]
                if slips:
                    across -= s[c] * s[d] / max(length, 1e-300) ** 2
                K[e, c, d] = stiffness * across
    return energy, force, K


@_compile
def mean_slide(points, anchor, normal, area):
    """Mean way of points (m, 3) from their anchors across the normals, of those with anchors."""
    total = slid = 0.0
    for i in range(len(points)):
        a0, a1 = points[i, 0] - anchor[i, 0], points[i, 1] - anchor[i, 1]
        a2 = points[i, 2] - anchor[i, 2]
        along = a0 * normal[i, 0] + a1 * normal[i, 1] + a2 * normal[i, 2]
        s0, s1, s2 = a0 - along * normal[i, 0], a1 - along * normal[i, 1], a2 - along * normal[i, 2]
        way = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
        if not np.isnan(way):
            total += area[i]
            slid += area[i] * way
    return slid / total if total else 0.0


# Tools


@_compile
def _rounded(x, y, z, core, n, H):
    """Distance of a point from a convex core; sets its gradient n (3,) and curvature H (3, 3)."""
    corners, start, t, length, N, c, sides, least = core
    n_faces, n_edges = len(N), len(t)
    inside, highest, height = n_faces > 0, 0, -np.inf
    nearest, square = 0, np.inf
    for f in range(n_faces):
        above = x * N[f, 0] + y * N[f, 1] + z * N[f, 2] + c[f]
        if above > height:
            highest, height = f, above
        if above <= 0.0:
            continue
        inside, over = False, True
        for k in range(3 * f, 3 * f + 3):
            over &= x * sides[k, 0] + y * sides[k, 1] + z * sides[k, 2] >= least[k]
        if over and above * above < square:
            nearest, square = f, above * above
    for a in range(3):
        for b in range(3):
            H[a, b] = 0.0
    if inside:
        n[0], n[1], n[2] = N[highest]
        return height
    for k in range(n_edges):
        a0, a1, a2 = x - start[k, 0], y - start[k, 1], z - start[k, 2]
        s = a0 * t[k, 0] + a1 * t[k, 1] + a2 * t[k, 2]
        if not 0.0 < s < length[k]:
            continue
        a0, a1, a2 = a0 - s * t[k, 0], a1 - s * t[k, 1], a2 - s * t[k, 2]
        if a0 * a0 + a1 * a1 + a2 * a2 < square:
            nearest, square = n_faces + k, a0 * a0 + a1 * a1 + a2 * a2
            n[0], n[1], n[2] = a0, a1, a2
    for k in range(len(corners)):
        a0, a1, a2 = x - corners[k, 0], y - corners[k, 1], z - corners[k, 2]
        if a0 * a0 + a1 * a1 + a2 * a2 < square:
            nearest, square = n_faces + n_edges + k, a0 * a0 + a1 * a1 + a2 * a2
            n[0], n[1], n[2] = a0, a1, a2
    d = np.sqrt(square)
    if nearest < n_faces:
        n[0], n[1], n[2] = N[nearest]
        return d
    away = d if d > 0.0 else np.inf  # on the core itself d has no gradient
    for a in range(3):
        n[a] /= away
    for a in range(3):
        for b in range(3):
            H[a, b] = (1.0 if a == b else 0.0) - n[a] * n[b]
            if nearest < n_faces + n_edges:
                H[a, b] -= t[nearest - n_faces, a] * t[nearest - n_faces, b]
            H[a, b] /= away
    return d


@_compile
def rounded(points, core, radius):
    """`Rounded.distance`: d (m,), n (m, 3) and H (m, 3, 3) at points (m, 3)."""
    m = len(points)
    d, n, H = np.empty(m), np.empty((m, 3)), np.empty((m, 3, 3))
    for e in range(m):
        x, y, z = points[e]
        d[e] = _rounded(x, y, z, core, n[e], H[e]) - radius
    return d, n, H


@_compile
def opening(points, core, radius, fillet, low, high):
    """`Opening.distance`: beyond the corners low and high (2,) that of the plate."""
    count = len(points)
    d, n, H = np.empty(count), np.empty((count, 3)), np.empty((count, 3, 3))
    m, bend, t = np.empty(3), np.empty((3, 3)), np.empty(3)
    for e in range(count):
        x, y, z = points[e]
        if not (low[0] < x < high[0] and low[1] < y < high[1]):
            d[e], n[e, 0], n[e, 1], n[e, 2] = z, 0.0, 0.0, 1.0
            H[e] = 0.0
            continue
        s = _rounded(x, y, 0.0, core, m, bend) - radius
        depth, to_wall = z + fillet, fillet - s
        u, v = min(-to_wall, 0.0), max(depth, 0.0)
        if u == 0.0 and v == 0.0:  # deep in the plate the nearer of face and wall counts
            q = 1.0
            d[e] = max(depth, to_wall) - fillet
            n_m, n_z = (-1.0, 0.0) if to_wall > depth else (0.0, 1.0)
        else:
            q = np.sqrt(u * u + v * v)
            d[e], n_m, n_z = q - fillet, u / q, v / q
        fillet_curvature = 1.0 / q if u < 0.0 and v > 0.0 else 0.0
        for a in range(3):
            n[e, a], t[a] = n_m * m[a], n_z * m[a]
        n[e, 2], t[2] = n_z, -n_m
        for a in range(3):
            for b in range(3):
                H[e, a, b] = fillet_curvature * t[a] * t[b] + n_m * bend[a, b]
    return d, n, H
