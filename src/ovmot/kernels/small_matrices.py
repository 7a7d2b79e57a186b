"""Compiled algebra of fixed small size: 3x3 and 4x4 matrices, vectors of three.

Called by kernels only; arrays are filled in place. `tests/kernels/test_small_matrices.py` holds the
plain NumPy twins.
"""

import math

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import inlined_part, part

Vector = tuple[float, float, float]


@inlined_part
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product a x b of vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined_part
def invert_symmetric(N: FloatArray, out: FloatArray) -> None:
    """Inverse (3, 3) of a symmetric matrix, given by its upper triangle, by cofactors."""
    a, b, c, d, e, f = N[0, 0], N[0, 1], N[0, 2], N[1, 1], N[1, 2], N[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * C
    out[0, 0], out[1, 1], out[2, 2] = A / det, (a * f - c * c) / det, (a * d - b * b) / det
    out[0, 1] = out[1, 0] = B / det
    out[0, 2] = out[2, 0] = C / det
    out[1, 2] = out[2, 1] = (b * c - a * e) / det


@inlined_part
def squared_mahalanobis(error: FloatArray, C: FloatArray) -> float:
    """eᵀ C⁻¹ e of an error (3,) with covariance (3, 3), by cofactors."""
    a, b, c, d, e, f = C[0, 0], C[0, 1], C[0, 2], C[1, 1], C[1, 2], C[2, 2]
    A, B, D = d * f - e * e, c * e - b * f, b * e - c * d
    x, y, z = error[0], error[1], error[2]
    total = A * x * x + (a * f - c * c) * y * y + (a * d - b * b) * z * z
    total += 2.0 * (B * x * y + D * x * z + (b * c - a * e) * y * z)
    return float(total / (a * A + b * B + c * D))


@inlined_part
def add_products(rows: FloatArray, out: FloatArray) -> None:
    """Add rowsᵀ rows (k, k) of rows (4, k)."""
    for a in range(rows.shape[1]):
        for b in range(rows.shape[1]):
            total = rows[0, a] * rows[0, b] + rows[1, a] * rows[1, b]
            total += rows[2, a] * rows[2, b] + rows[3, a] * rows[3, b]
            out[a, b] += total


@inlined_part
def whiten(S: FloatArray, rows: FloatArray, n_columns: int) -> None:
    """Replace S (4, 4) by its Cholesky factor L, and the first columns of rows (4, k) by L⁻¹ rows.

    The lower triangle of S counts, and its diagonal becomes that of 1/L.
    """
    for i in range(4):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            S[i, j] = 1.0 / math.sqrt(total) if i == j else total * S[j, j]
    for c in range(n_columns):
        for i in range(4):
            total = rows[i, c]
            for k in range(i):
                total -= S[i, k] * rows[k, c]
            rows[i, c] = total * S[i, i]


@part
def invert_definite(A: FloatArray) -> None:
    """Replace a symmetric positive definite A (k, k) by its inverse, by Gauss-Jordan steps."""
    n = len(A)
    for p in range(n):
        pivot = 1.0 / A[p, p]
        A[p, p] = 1.0
        for j in range(n):
            A[p, j] *= pivot
        for i in range(n):
            if i != p:
                factor = A[i, p]
                A[i, p] = 0.0
                for j in range(n):
                    A[i, j] -= factor * A[p, j]


@part
def factor(A: FloatArray) -> None:
    """Replace the lower triangle of A (n, n), positive definite, by that of L with L Lᵀ = A."""
    for i in range(len(A)):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = math.sqrt(total) if i == j else total / A[j, j]


@part
def solve_lower(L: FloatArray, X: FloatArray) -> None:
    """Replace X (n, k) by L⁻¹ X, L (n, n) lower triangular."""
    for i in range(len(X)):
        for c in range(X.shape[1]):
            for k in range(i):
                X[i, c] -= L[i, k] * X[k, c]
            X[i, c] /= L[i, i]


@part
def solve_positive(A: FloatArray, x: FloatArray) -> None:
    """Replace x (n,) by A⁻¹ x, A (n, n) positive definite: its lower triangle becomes L of L Lᵀ."""
    factor(A)
    n = len(x)
    for i in range(n):
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]


@part
def eigen_symmetric(C: FloatArray, values: FloatArray, axes: FloatArray) -> None:
    """Eigenvalues (3,), rising, and eigenvectors (3, 3) in columns of a symmetric matrix (3, 3).

    Jacobi's rotations, until the matrix is diagonal (G. Golub, C. Van Loan, "Matrix Computations",
    sec. 8.5).
    """
    A = C.copy()
    for a in range(3):
        for b in range(3):
            axes[a, b] = 1.0 if a == b else 0.0
    for _ in range(30):
        off = abs(A[0, 1]) + abs(A[0, 2]) + abs(A[1, 2])
        if not off > 1e-300 + 1e-17 * (abs(A[0, 0]) + abs(A[1, 1]) + abs(A[2, 2])):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                rotate_out(A, axes, p, q)
    for k in range(3):
        values[k] = A[k, k]
    for k in range(2):  # the least one to the front
        for m in range(2, k, -1):
            if values[m] < values[m - 1]:
                values[m], values[m - 1] = values[m - 1], values[m]
                for a in range(3):
                    axes[a, m], axes[a, m - 1] = axes[a, m - 1], axes[a, m]


@part
def rotate_out(A: FloatArray, axes: FloatArray, p: int, q: int) -> None:
    """Turn the axes (3, 3) p and q so that the element p, q of A (3, 3) becomes zero."""
    if A[p, q] == 0.0:
        return
    half = 0.5 * (A[q, q] - A[p, p]) / A[p, q]
    t = (1.0 if half >= 0.0 else -1.0) / (abs(half) + math.sqrt(half * half + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(3):
        x, y = A[k, p], A[k, q]
        A[k, p], A[k, q] = c * x - s * y, s * x + c * y
    for k in range(3):
        x, y = A[p, k], A[q, k]
        A[p, k], A[q, k] = c * x - s * y, s * x + c * y
        x, y = axes[k, p], axes[k, q]
        axes[k, p], axes[k, q] = c * x - s * y, s * x + c * y
