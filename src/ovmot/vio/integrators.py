"""Integration of the IMU over each pair of samples, in the body frame at its start.

Preintegrated increments ΔR, Δv, Δp without gravity (C. Forster et al., TRO 2017), all pairs at
once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.vio.imu_kernel import rk4_increments_compiled


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
    """Runge-Kutta of 4th order with rates linear over each pair; arguments as above.

    The rotation vector's rate is J_r⁻¹(φ) ω: one step on φ from zero. v' = R a and p' = v: with
    a(t) known, Runge-Kutta is Simpson's rule.
    """
    increments = rk4_increments_compiled(
        np.ascontiguousarray(gyro), np.ascontiguousarray(accel), dt
    )
    return Increments(*increments, dt)


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
