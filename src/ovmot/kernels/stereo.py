"""Compiled stereo geometry of single points: triangulation, projection, covariance.

Called by kernels only; arrays are filled in place. Image points are normalized (undistorted)
coordinates, points are in the left camera in metres, T (4, 4) is `T_cam1_cam0` unless it is named
otherwise. The plain NumPy twins are those of `geometry.triangulation`.
"""

from ovmot.geometry.arrays import FloatArray
from ovmot.kernels.cache import inlined_part


@inlined_part
def transform(T: FloatArray, p: FloatArray, out: FloatArray) -> None:
    """out (3,) = T p."""
    for a in range(3):
        out[a] = T[a, 0] * p[0] + T[a, 1] * p[1] + T[a, 2] * p[2] + T[a, 3]


@inlined_part
def triangulate(uv: FloatArray, T: FloatArray, p: FloatArray) -> bool:
    """Point p (3,) of a stereo pair uv (4,), as `triangulate_stereo`; False where there is none."""
    x = T[0, 0] * uv[0] + T[0, 1] * uv[1] + T[0, 2]
    y = T[1, 0] * uv[0] + T[1, 1] * uv[1] + T[1, 2]
    z = T[2, 0] * uv[0] + T[2, 1] * uv[1] + T[2, 2]
    a0, a1 = x - uv[2] * z, y - uv[3] * z
    b0, b1 = uv[2] * T[2, 3] - T[0, 3], uv[3] * T[2, 3] - T[1, 3]
    depth = (a0 * b0 + a1 * b1) / (a0 * a0 + a1 * a1)
    p[0], p[1], p[2] = uv[0] * depth, uv[1] * depth, depth
    return bool(0.0 < depth < 1e4 and depth * z + T[2, 3] > 0.0)


@inlined_part
def project(p: FloatArray, T: FloatArray, h: FloatArray, J: FloatArray) -> None:
    """Both views h (4,) of a point and their derivative J (4, 3), as `project_stereo`."""
    q0, q1, q2 = _transformed(T, p)
    per_z, per_q = 1.0 / p[2], 1.0 / q2
    h[0], h[1], h[2], h[3] = p[0] * per_z, p[1] * per_z, q0 * per_q, q1 * per_q
    J[0, 0], J[0, 1], J[0, 2] = per_z, 0.0, -h[0] * per_z
    J[1, 0], J[1, 1], J[1, 2] = 0.0, per_z, -h[1] * per_z
    for k in range(3):
        J[2, k] = (T[0, k] - h[2] * T[2, k]) * per_q
        J[3, k] = (T[1, k] - h[3] * T[2, k]) * per_q


@inlined_part
def secant(p_from: FloatArray, p_to: FloatArray, T: FloatArray, D: FloatArray) -> None:
    """D (4, 3) with h(p_to) - h(p_from) = D (p_to - p_from) for both views h, exactly.

    In one view, with x = X/Z: x' - x = ((X' - X) - x (Z' - Z)) / Z'.
    """
    q0, q1, q2 = _transformed(T, p_from)
    per_z = 1.0 / p_to[2]
    per_q = 1.0 / (T[2, 0] * p_to[0] + T[2, 1] * p_to[1] + T[2, 2] * p_to[2] + T[2, 3])
    D[0, 0], D[0, 1], D[0, 2] = per_z, 0.0, -p_from[0] / p_from[2] * per_z
    D[1, 0], D[1, 1], D[1, 2] = 0.0, per_z, -p_from[1] / p_from[2] * per_z
    for k in range(3):
        D[2, k] = (T[0, k] - q0 / q2 * T[2, k]) * per_q
        D[3, k] = (T[1, k] - q1 / q2 * T[2, k]) * per_q


@inlined_part
def stereo_covariance(p: FloatArray, T: FloatArray, sigma: FloatArray, C: FloatArray) -> None:
    """Covariance C (3, 3) of a triangulated point, m², as `geometry.triangulation` has it.

    `sigma` (4,): standard deviations of the normalized coordinates of both views.
    """
    q0, q1, q2 = _transformed(T, p)
    x, y, z, per_q = p[0] / p[2], p[1] / p[2], p[2], 1.0 / q2
    h2, h3 = q0 * per_q, q1 * per_q
    a0, a1 = (T[0, 0] - h2 * T[2, 0]) * per_q, (T[0, 1] - h2 * T[2, 1]) * per_q
    b0, b1 = (T[1, 0] - h3 * T[2, 0]) * per_q, (T[1, 1] - h3 * T[2, 1]) * per_q
    # derivative of the right view by the depth, and of the depth by the views
    along0 = a0 * x + a1 * y + (T[0, 2] - h2 * T[2, 2]) * per_q
    along1 = b0 * x + b1 * y + (T[1, 2] - h3 * T[2, 2]) * per_q
    square = along0 * along0 + along1 * along1
    right0, right1 = along0 / square, along1 / square
    left0, left1 = right0 * a0 + right1 * b0, right0 * a1 + right1 * b1
    by_u0 = (z * (1.0 - x * left0) * sigma[0], -z * y * left0 * sigma[0], -z * left0 * sigma[0])
    by_v0 = (-z * x * left1 * sigma[1], z * (1.0 - y * left1) * sigma[1], -z * left1 * sigma[1])
    along_ray = (right0 * sigma[2]) ** 2 + (right1 * sigma[3]) ** 2
    ray = (x, y, 1.0)
    for a in range(3):
        for b in range(3):
            C[a, b] = by_u0[a] * by_u0[b] + by_v0[a] * by_v0[b] + along_ray * ray[a] * ray[b]


@inlined_part
def _transformed(T: FloatArray, p: FloatArray) -> tuple[float, float, float]:
    """T p of a point (3,)."""
    return (
        T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3],
        T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3],
        T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3],
    )
