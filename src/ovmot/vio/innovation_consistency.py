"""Do the features of an update agree with the IMU? Where most move together, the IMU decides.

Each feature may pass its own gate and all of them together still ask for a velocity that the IMU
rules out: a lorry that fills the view and drives off is as rigid as a street. With the whitened
innovation y = L⁻¹ r ~ N(0, I), S = L Lᵀ, the update changes the velocity by Wᵀ y, W = L⁻¹ H P_v.
So the projection of y on the three columns of W is all that the update says about velocity; its
squared length is chi-squared with 3 degrees of freedom.

A feature whose innovation is larger than expected gets Huber's weight (P. Huber, 1964). Where the
velocity that all ask for is beyond the gate, the half of them that is nearest to the prediction is
tried, and so on; the others get weight 0. Fewer features than components of the velocity cannot
contradict each other. The kernels do it: `msckf_kernel`,
`landmark_kernel`.
"""

from ovmot.physics import VARIANCE_FACTOR, gate
from ovmot.vio.state import VELOCITY

_PROBABILITY = 1.0 - 1e-5
VELOCITY_BOUND = VARIANCE_FACTOR * gate(VELOCITY.stop - VELOCITY.start, _PROBABILITY)
"""Squared Mahalanobis distance of the velocity that features may ask for together."""
