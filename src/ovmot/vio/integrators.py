"""Integration of the IMU over each pair of samples, in the body frame at its start.

Preintegrated increments ΔR, Δv, Δp without gravity (C. Forster et al., TRO 2017), all pairs at
once.
"""

from collections.abc import Callable
from dataclasses import dataclass

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Increments:
    """Preintegrated motion over each of n sample pairs, in the body frame at its start.

    `rotation` (n, 3, 3), `velocity` (n, 3), m/s, and `position` (n, 3), m, without gravity; `dt`
    (n,): length, s.
    """

    rotation: FloatArray
    velocity: FloatArray
    position: FloatArray
    dt: FloatArray


Integrator = Callable[[FloatArray, FloatArray, FloatArray], Increments]


def integrate_discrete(gyro: FloatArray, accel: FloatArray, dt: FloatArray) -> Increments:
    """Mean rates, constant over each pair: gyro, rad/s, and accel, m/s² (n + 1, 3), without bias;
    dt (n,), s."""
    w, a = 0.5 * (gyro[:-1] + gyro[1:]), 0.5 * (accel[:-1] + accel[1:])
    step = dt[:, None]
    return Increments(so3.exp(w * step), a * step, 0.5 * a * step**2, dt)


def integrate_rk4(gyro: FloatArray, accel: FloatArray, dt: FloatArray) -> Increments:
    """Runge-Kutta of 4th order with rates linear over each pair; arguments as above."""
    h = dt[:, None]
    w0, w1, a0, a1 = gyro[:-1], gyro[1:], accel[:-1], accel[1:]
    wm, am = 0.5 * (w0 + w1), 0.5 * (a0 + a1)

    # The rotation vector's rate is J_r^-1(φ) ω: one RK4 step on φ from zero.
    def rate(phi: FloatArray, w: FloatArray) -> FloatArray:
        return (so3.right_jacobian_inverse(phi) @ w[..., None])[..., 0]

    k1 = w0
    k2 = rate(0.5 * h * k1, wm)
    k3 = rate(0.5 * h * k2, wm)
    k4 = rate(h * k3, w1)
    phi = h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    R_mid, R_end = so3.exp(0.5 * h * k2), so3.exp(phi)
    # v' = R a and p' = v: with a(t) known, RK4 is Simpson's rule.
    f0, fm, f1 = a0, (R_mid @ am[..., None])[..., 0], (R_end @ a1[..., None])[..., 0]
    return Increments(
        R_end, h / 6.0 * (f0 + 4.0 * fm + f1), h**2 / 6.0 * (f0 + 2.0 * fm), dt
    )  # fmt: skip


def integrate_analytic(gyro: FloatArray, accel: FloatArray, dt: FloatArray) -> Increments:
    """Closed form for mean rates that are constant in the body frame over each pair.

    ∫exp(ωt)dt = J_l(ωh) h, and the integral of that in closed form (Y. Yang et al., TRO 2023).
    """
    h = dt[:, None]
    w, a = 0.5 * (gyro[:-1] + gyro[1:]), 0.5 * (accel[:-1] + accel[1:])
    phi = w * h
    velocity = h * (so3.left_jacobian(phi) @ a[..., None])[..., 0]
    position = h**2 * (so3.second_left_jacobian(phi) @ a[..., None])[..., 0]
    return Increments(so3.exp(phi), velocity, position, dt)


INTEGRATORS: dict[str, Integrator] = {
    "discrete": integrate_discrete,
    "rk4": integrate_rk4,
    "analytic": integrate_analytic,
}
